"""A decay in twenty lines: requests in lines of JSON, and replies."""

import json
import math
import sys

DESCRIPTION = {
    "protocol": 1,
    "parameters": {"k": {"min": 0.5, "max": 2.0, "unit": "1/s"}},
    "outputs": {"x": {"unit": "m"}},
    "stop": 2.0,
    "step": 0.02,
}
for line in sys.stdin:
    request = json.loads(line)
    if request["request"] == "describe":
        reply = DESCRIPTION
    else:
        k = request["parameters"]["k"]
        reply = {"outputs": {"x": [math.exp(-k * t) for t in request["times"]]}}
    print(json.dumps({"id": request["id"], **reply}), flush=True)
