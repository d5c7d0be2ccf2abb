"""Programs as sources: what goes wrong in them, and surrogates of the examples in examples/commands."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import types

import numpy as np
import pytest
from conftest import METAFMU, OTHER_THREADS, ROOT, SMALL, change, metafmu
from scipy.integrate import solve_ivp

COMMANDS = ROOT / "examples" / "commands"
# where the program goes wrong: range of k, what it does, and what is reported
FAULTS = [
    (0.05, 0.10, "os._exit(3)", "the program ended with exit code 3: note: k ="),
    (0.15, 0.20, "os.abort()", "its process ended with signal: 6 (SIGABRT)"),
    (0.25, 0.27, "time.sleep(60)", "took longer than 1s (source.time_limit)"),
    (0.30, 0.35, "print('step 1 of 10', flush=True)", "the program printed `step 1 of 10` to standard output, expected a reply in JSON"),
    (0.40, 0.45, "outputs['x'] = [1.0]", "output `x` has 1 values, expected 11"),
    (0.50, 0.55, "del outputs['y']", "the reply has no output `y`"),
    (0.60, 0.65, "outputs['y'][3] = float('nan')", "output `y` is not finite at 0.3 s"),
    (0.70, 0.75, "outputs['x'] = 'many'", "has a wrong shape: invalid type: string \"many\", expected a sequence"),
    (0.80, 0.85, "print('{}', flush=True)", "the reply has no `id`, expected"),
    (0.90, 0.95, "raise ValueError('no solution')", "the program ended with exit code 1: ValueError: no solution"),
]
PROGRAM = """
import json, os, sys, time
parameters = {"k": {"min": 0, "max": 1, "unit": "1/s"}}
outputs = {"x": {"unit": "m"}, "y": {}}
runs = 0
for line in sys.stdin:
    request = json.loads(line)
    if request["request"] == "describe":
        print(json.dumps({"id": request["id"], "protocol": 1, "parameters": parameters, "outputs": outputs, "stop": 1, "step": 0.1}), flush=True)
        continue
    runs += 1
    k, times = request["parameters"]["k"], request["times"]
    outputs = {"x": [k * t for t in times], "y": [t + k for t in times]}
    print("note: k =", k, file=sys.stderr, flush=True)
@FAULTS@
    print(json.dumps({"id": request["id"], "outputs": outputs}), flush=True)
"""
STUDY = """name = "campaign"
[source]
command = [{python}, "program.py"]
time_limit = 1
max_failed = 0.9
[time]
stop = 1
step = 0.1
[parameters]
k = {{ min = 0, max = 1, unit = "1/s" }}
[outputs]
x = {{ unit = "m" }}
y = {{}}
""" + SMALL


def write_study(folder, faults="", study=STUDY):
    folder.mkdir(exist_ok=True)
    (folder / "program.py").write_text(PROGRAM.replace("@FAULTS@", faults))
    path = folder / "campaign.toml"
    path.write_text(study.format(python=json.dumps(sys.executable)))
    return path


def sample(study, out, *more, threads=None, check=True):
    command = [METAFMU, "sample", study, "--out", out, *more]
    environment = os.environ | ({} if threads is None else {"RAYON_NUM_THREADS": str(threads)})
    result = subprocess.run(list(map(str, command)), capture_output=True, text=True, env=environment)
    assert not check or result.returncode == 0, result.stderr
    return result


def tables(folder):
    return {name: (folder / name).read_bytes() for name in ("train.csv", "test.csv")}


def failed(folder):
    return json.loads((folder / "samples.json").read_text())["failed"]


def faulty():
    return "".join(f"    if {low} <= k < {high}: {what}\n" for low, high, what, _ in FAULTS)


def test_what_goes_wrong_costs_one_run_and_is_reported_with_the_same_bytes_for_threads_and_shards(tmp_path):
    study = write_study(tmp_path, faulty())
    out = tmp_path / "out"
    result = sample(study, out, threads=2)
    record = failed(out)
    assert f"warning: {len(record)} of 70 runs failed and are left out" in result.stderr
    for low, high, _, says in FAULTS:
        runs = [run for run in record if low <= run["parameters"]["k"] < high]
        assert runs and all(says in run["reason"] for run in runs), (says, runs)
    assert all(any(low <= run["parameters"]["k"] < high for low, high, *_ in FAULTS) for run in record)
    sample(study, tmp_path / "one", threads=1)
    assert tables(tmp_path / "one") == tables(out)
    for number in (1, 2, 3):
        sample(study, tmp_path / "shards", "--shard", f"{number}/3")
    sample(study, tmp_path / "shards", "--merge")
    assert tables(tmp_path / "shards") == tables(out) and failed(tmp_path / "shards") == record


def test_a_program_that_dies_at_its_tenth_run_loses_nothing(tmp_path):
    good = write_study(tmp_path / "good")
    sample(good, tmp_path / "out")
    dying = write_study(tmp_path / "dying", "    if runs == 10: sys.exit('out of memory')\n")
    for threads in (1, 3):
        sample(dying, tmp_path / f"out{threads}", threads=threads)
        assert failed(tmp_path / f"out{threads}") == []
        assert tables(tmp_path / f"out{threads}") == tables(tmp_path / "out")
    # without retries the tenth run of each process is missing
    dying.write_text(dying.read_text().replace("time_limit = 1", "time_limit = 1\nretries = 0"))
    sample(dying, tmp_path / "lossy", threads=1)
    assert len(failed(tmp_path / "lossy")) == 7
    assert all(run["reason"] == "the program ended with exit code 1: out of memory" for run in failed(tmp_path / "lossy"))


@pytest.mark.parametrize(
    ("memory", "says"),
    [
        # a state that no run resets
        ("outputs['y'][5] += 0.1 * runs", "a difference of 0.1, 0.1 of its range"),
        # the run before, as a solver that starts from its last solution
        ("globals().setdefault('last', [0.0]).insert(0, k); outputs['x'][3] += 1e-9 * last[1]", "of its range"),
        # noise
        ("import random; outputs['x'] = [x + random.gauss(0, 1e-3) for x in outputs['x']]", "of its range"),
        # a file that one run leaves to the next
        ("open('calls', 'a').write('.'); outputs['y'][5] += 0.1 * os.stat('calls').st_size", "a difference of "),
    ],
)
def test_a_program_whose_results_depend_on_earlier_runs_is_refused(tmp_path, memory, says):
    calls = f"    open('{tmp_path}/all-calls', 'a').write('.')\n"
    study = write_study(tmp_path, f"{calls}    {memory}\n")
    for threads in (1, 3):
        (tmp_path / "all-calls").unlink(missing_ok=True)
        result = sample(study, tmp_path / "out", threads=threads, check=False)
        assert result.returncode == 2 and "campaign.toml:3: source.command: output `" in result.stderr, result.stderr
        assert " when that is repeated after other runs: " in result.stderr and says in result.stderr, result.stderr
        assert "noise, set source.repeats = 0" in result.stderr and not (tmp_path / "out" / "train.csv").exists()
        # before most of the 70 runs
        assert threads > 1 or 3 <= (tmp_path / "all-calls").stat().st_size <= 4
    study.write_text(study.read_text().replace("time_limit", "repeats = 0\ntime_limit"))
    sample(study, tmp_path / "out")


def test_equations_that_depend_on_earlier_requests_are_refused(tmp_path, package):
    study = new(tmp_path, "oscillator", "oscillator.py", "--structure", "dynamics")
    script = study.parent / "oscillator.py"
    text = script.read_text()
    assert "    def equations(self, parameters, inputs, states):\n" in text
    drift = "        self.drift = getattr(self, 'drift', 0.0) + 1e-6\n        states = states | {'v': states['v'] + self.drift}\n"
    script.write_text(text.replace("    def equations(self, parameters, inputs, states):\n", f"    def equations(self, parameters, inputs, states):\n{drift}"))
    result = metafmu("sample", study, "--out", tmp_path / "out", check=False)
    assert result.returncode == 2 and "source.command: the derivative of `" in result.stderr, result.stderr
    assert " at damping = " in result.stderr and "repeated after other runs" in result.stderr, result.stderr


def test_a_program_that_leaks_memory_is_replaced_at_the_limit(tmp_path):
    leak = f"    import resource\n    globals().setdefault('leak', []).append(b'x' * 30_000_000)\n"
    peak = f"    open('{tmp_path}/peak', 'a').write(f'{{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss}}\\n')\n"
    study = write_study(tmp_path / "leaking", leak + peak)
    text = study.read_text()
    study.write_text(text.replace("time_limit", "memory_limit = 150\ntime_limit"))
    sample(study, tmp_path / "out", threads=1)
    # kilobytes: four runs of 30 MB in a process, never six
    peaks = [int(line) for line in (tmp_path / "peak").read_text().split()]
    assert len(peaks) >= 70 and 130_000 < max(peaks) < 185_000, max(peaks)
    sample(write_study(tmp_path / "good"), tmp_path / "whole")
    assert tables(tmp_path / "out") == tables(tmp_path / "whole") and failed(tmp_path / "out") == []
    study.write_text(text.replace("time_limit", "memory_limit = 0\ntime_limit"))
    assert "source.memory_limit: 0, expected a positive" in sample(study, tmp_path / "out", check=False).stderr


def test_a_killed_sampling_continues_and_a_changed_model_is_not_resumed(tmp_path):
    slow = write_study(tmp_path / "slow", f"    open('{tmp_path}/calls', 'a').write('.')\n    time.sleep(0.05)\n")
    out = tmp_path / "out"
    calls = tmp_path / "calls"
    process = subprocess.Popen([METAFMU, "sample", slow, "--out", out], stderr=subprocess.DEVNULL)
    while not calls.exists() or calls.stat().st_size < 20:
        time.sleep(0.02)
    process.kill()
    process.wait()
    made = calls.stat().st_size
    sample(slow, out)
    # both repeat two runs
    assert calls.stat().st_size <= 70 + 4 + 4 < made + 70
    sample(write_study(tmp_path / "good"), tmp_path / "whole")
    assert tables(out) == tables(tmp_path / "whole")
    # another program: the runs before are of no use
    process = subprocess.Popen([METAFMU, "sample", slow, "--out", tmp_path / "again"], stderr=subprocess.DEVNULL)
    before = calls.stat().st_size
    while calls.stat().st_size < before + 20:
        time.sleep(0.02)
    process.kill()
    process.wait()
    write_study(tmp_path / "slow", f"    open('{tmp_path}/calls', 'a').write('.')\n    outputs['x'][0] = 7.0\n")
    before = calls.stat().st_size
    sample(slow, tmp_path / "again")
    assert calls.stat().st_size == before + 70 + 2
    assert b",7.0," in tables(tmp_path / "again")["train.csv"]


def test_files_that_the_program_reads_count_by_their_content(tmp_path):
    study = write_study(tmp_path)
    study.write_text(study.read_text().replace("time_limit", 'files = ["data.txt"]\ntime_limit'))
    result = metafmu("sample", study, "--out", tmp_path / "out", check=False)
    assert result.returncode == 2 and "campaign.toml:4: source.files: " in result.stderr and "data.txt" in result.stderr

    def digest(text):
        (tmp_path / "data.txt").write_text(text)
        metafmu("sample", study, "--out", tmp_path / "out")
        return json.loads((tmp_path / "out" / "samples.json").read_text())["sampling_digest"]

    assert digest("1") == digest("1") != digest("2")


def test_ctrl_c_ends_the_programs(tmp_path):
    study = write_study(tmp_path, f"    open('{tmp_path}/pid', 'w').write(str(os.getpid()))\n    time.sleep(60)\n")
    study.write_text(study.read_text().replace("time_limit = 1\n", ""))
    process = subprocess.Popen([METAFMU, "sample", study, "--out", tmp_path / "out"], stderr=subprocess.DEVNULL)
    pid = tmp_path / "pid"
    while not pid.exists() or not pid.read_text():
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    assert process.wait(10) == 130
    worker = int(pid.read_text())
    for _ in range(100):
        try:
            os.kill(worker, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    pytest.fail("the program still runs")


@pytest.mark.parametrize(
    ("program", "says"),
    [
        ("print('hello')", "the program printed `hello` to standard output, expected a reply in JSON"),
        ("raise SystemExit('no license')", "the program ended with exit code 1: no license"),
        ("import time; time.sleep(60)", "no description within 1s (source.time_limit)"),
        ("input(); print('{\"id\": 1}')", "the reply to `describe` has no `protocol`, expected 1"),
        ("input(); print('{\"id\": 1, \"protocol\": 2}')", "the program has protocol 2, expected 1"),
        ("input(); print('{\"id\": 1, \"error\": \"no license\"}')", "no license"),
    ],
)
def test_a_program_that_does_not_describe_itself_is_refused(tmp_path, program, says):
    study = write_study(tmp_path)
    (tmp_path / "program.py").write_text(program)
    result = metafmu("sample", study, "--out", tmp_path / "out", check=False)
    assert result.returncode == 2 and says in result.stderr and "program.py: " in result.stderr, result.stderr


def test_everything_that_differs_from_the_description_is_reported_at_once(tmp_path):
    study = write_study(tmp_path)
    text = study.read_text()
    for line, other in [
        ('k = { min = 0, max = 1, unit = "1/s" }', "k = { min = -1, max = 1 }\nl = { min = 0, max = 1 }"),
        ('x = { unit = "m" }\ny = {}', 'x = { unit = "mm" }\nz = {}'),
        ("time_limit", "constants = { c = 1 }\ntime_limit"),
    ]:
        assert line in text
        text = text.replace(line, other)
    study.write_text(text)
    result = metafmu("sample", study, "--out", tmp_path / "out", check=False)
    assert result.returncode == 2
    for says in [
        "campaign.toml:4: source.constants.c: the program has no parameter `c`, expected one of k",
        "campaign.toml:11: parameters.k: range from -1 to 1, the program takes 0 to 1",
        "campaign.toml:11: parameters.k.unit: missing, expected `1/s`",
        "campaign.toml:12: parameters.l: the program has no parameter `l`",
        "campaign.toml:14: outputs.x.unit: `mm`, expected `m`: values are in the program's unit",
        "campaign.toml:15: outputs.z: the program has no output `z`",
    ]:
        assert says in result.stderr, result.stderr


def test_keys_of_other_sources_are_refused(tmp_path):
    study = write_study(tmp_path)
    text = study.read_text()
    for line, says in [
        ("tolerance = 1e-6", "source.tolerance: belongs to sources that metafmu integrates"),
        ("step = 0.1", "source.step: belongs to `fmu`"),
        ('fmu = "model.fmu"', "expected one of `system`, `mechanism`, `fmu`, `command`, `table` and `index`"),
    ]:
        study.write_text(text.replace("time_limit = 1", line))
        result = metafmu("sample", study, "--out", tmp_path / "out", check=False)
        assert result.returncode == 2 and says in result.stderr, result.stderr
    study.write_text(text.replace('"program.py"]', '"program.py", "{result}"]'))
    result = metafmu("sample", study, "--out", tmp_path / "out", check=False)
    assert "parameters.k: has no effect: expected `{k}` in an argument of source.command" in result.stderr
    study.write_text(re.sub(r"command = .*", "command = []", text))
    assert "source.command: no program" in metafmu("sample", study, check=False).stderr
    study.write_text(re.sub(r"command = .*", 'command = ["./none"]', text))
    assert "./none: cannot start" in (stderr := metafmu("sample", study, "--out", tmp_path / "out", check=False).stderr), stderr


@pytest.fixture
def package(tmp_path, monkeypatch):
    """`metafmu.source` without the package that has to be built."""
    (tmp_path / "package").mkdir()
    shutil.copy(ROOT / "python" / "python" / "metafmu" / "_source.py", tmp_path / "package" / "metafmu.py")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "package"))


def new(folder, name, script, *options):
    """The study that `new` proposes of a copy of an example."""
    source = COMMANDS / script
    work = shutil.copytree(source.parent, folder / name, ignore=lambda *_: {"__pycache__"})
    metafmu("new", name, *options, "--command", sys.executable, source.name, cwd=work)
    return work / f"{name}.toml"


def test_twenty_lines_of_python_are_a_source(tmp_path):
    study = new(tmp_path, "decay", "protocol.py")
    text = study.read_text()
    assert 'k = { min = 0.5, max = 2.0, unit = "1/s" }' in text and 'x = { unit = "m" }' in text and "step = 0.02 " in text
    change(study, (r"\nruns = \d+", "\nruns = 30"), (r"test_runs = \d+", "test_runs = 5"))
    metafmu("sample", study, "--out", tmp_path / "out")
    rows = np.genfromtxt(tmp_path / "out" / "test.csv", delimiter=",", names=True)
    assert np.abs(rows["x"] - np.exp(-rows["k"] * rows["time"])).max() < 1e-15
    assert len((COMMANDS / "protocol.py").read_text().splitlines()) <= 24


def test_a_scipy_function_is_built_and_validated(tmp_path, package):
    study = new(tmp_path, "spring", "spring_pendulum.py")
    assert "# rest length of the spring" in study.read_text()
    change(study, (r"\nruns = \d+", "\nruns = 60"), (r"test_runs = \d+", "test_runs = 10"), (r"epochs = \d+ ", "epochs = 60 "))
    result = metafmu("build", study, "--out", tmp_path / "out", check=False)
    assert (tmp_path / "out" / "spring.fmu").exists(), result.stderr
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["outputs"]["angle"]["r2"] > 0.9, metrics["outputs"]


def test_equations_of_a_class_are_learned(tmp_path, package):
    study = new(tmp_path, "oscillator", "oscillator.py", "--structure", "dynamics")
    change(study, (r"test_runs = \d+", "test_runs = 5"), (r"\nstates = \d+", "\nstates = 1000"))
    result = metafmu("build", study, "--out", tmp_path / "out")
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    # a polynomial, which the dictionary has exactly
    assert metrics["outputs"]["spring"]["r2"] > 0.999999, result.stdout
    # a state that is missing
    change(study, (r'\nv = \{ min.*', ""))
    result = metafmu("build", study, "--out", tmp_path / "out", check=False)
    assert "states: without v, expected every state of the program" in result.stderr, result.stderr


def test_a_class_driven_by_inputs_is_learned_from_samples(tmp_path, package):
    study = new(tmp_path, "oscillator", "oscillator.py", "--structure", "discrete")
    change(study, (r"\nruns = \d+", "\nruns = 6"), (r"test_runs = \d+", "test_runs = 2"), (r"epochs = \d+", "epochs = 3"))
    metafmu("sample", study, "--out", tmp_path / "out")
    rows = np.genfromtxt(tmp_path / "out" / "train.csv", delimiter=",", names=True)
    assert np.ptp(rows["force"]) > 1 and np.ptp(rows["spring"]) > 0.1


def test_a_shell_command_writes_a_file_for_each_run(tmp_path):
    work = shutil.copytree(COMMANDS / "shell", tmp_path / "shell")
    study = work / "oscillation.toml"
    metafmu("sample", study, "--out", tmp_path / "out")
    rows = np.genfromtxt(tmp_path / "out" / "test.csv", delimiter=",", names=True)
    x = np.exp(-rows["damping"] * rows["time"]) * np.cos(2 * np.pi * rows["frequency"] * rows["time"])
    assert np.abs(rows["x"] - x).max() < 1e-11
    script = (work / "run.sh").read_text()
    limits = "[source]\ntime_limit = 1\nretries = 0\nmax_failed = 0"
    for more, says in [
        ("echo out of tokens >&2; exit 4", "the program ended with exit code 4: out of tokens"),
        ('rm "$5"', "the program ended with exit code 0, but did not write {result}"),
        ('sed -i 3d "$5"', "{result}:3: column `time`: 0.04, expected 0.02"),
        ('sed -i "s/x .m./x [mm]/" "$5"', "mm"),
        ("sleep 60", "took longer than 1s (source.time_limit)"),
    ]:
        (work / "run.sh").write_text(f"{script}{more}\n")
        study.write_text((COMMANDS / "shell" / "oscillation.toml").read_text().replace("[source]", limits))
        result = metafmu("sample", study, "--out", tmp_path / "bad", check=False)
        assert result.returncode == 2 and says in result.stderr, result.stderr


def test_a_program_that_closes_its_output_early_is_waited_for(tmp_path):
    work = shutil.copytree(COMMANDS / "shell", tmp_path / "shell")
    (work / "run.sh").write_text("exec > /dev/null 2>&1\nsleep 0.7\n" + (COMMANDS / "shell" / "run.sh").read_text())
    change(work / "oscillation.toml", (r"\nruns = \d+", "\nruns = 2"), (r"test_runs = \d+", "test_runs = 1"))
    metafmu("sample", work / "oscillation.toml", "--out", tmp_path / "out")


def test_new_says_what_a_program_lacks(tmp_path):
    write_study(tmp_path)
    for options, says in [
        (["--structure", "dynamics"], "the program describes no states"),
        (["--structure", "discrete"], "the program describes no inputs: nothing drives it"),
    ]:
        result = metafmu("new", "x", *options, "--command", sys.executable, "program.py", check=False, cwd=tmp_path)
        assert result.returncode == 2 and says in result.stderr, result.stderr
    result = metafmu("new", "x", "--command", "sh", "run.sh", "{result}", check=False, cwd=tmp_path)
    assert "docs/command-sources.md has a study of one" in result.stderr


def test_what_a_model_prints_goes_to_standard_error(tmp_path, package):
    (tmp_path / "loud.py").write_text(
        "import os, sys, metafmu\n"
        '@metafmu.source(parameters={"k": {"min": 0, "max": 1}}, outputs={"x": ""}, stop=1, step=0.5)\n'
        "def loud(times, parameters):\n"
        '    print("python"); os.system("echo shell")\n'
        '    if parameters["k"] > 0.9: raise ValueError("too large")\n'
        '    return {"x": parameters["k"] * times}\n'
        'if __name__ == "__main__": loud.serve()\n'
    )
    metafmu("new", "loud", "--command", sys.executable, "loud.py", cwd=tmp_path)
    change(tmp_path / "loud.toml", (r"\nruns = \d+", "\nruns = 20"), (r"test_runs = \d+", "test_runs = 5"), ("# max_failed = 0.1", "max_failed = 0.5"))
    metafmu("sample", "loud.toml", "--out", "out", cwd=tmp_path)
    reasons = {run["reason"] for run in failed(tmp_path / "out")}
    assert reasons == {"ValueError: too large"}


def test_the_arm_in_mujoco_has_equations_and_runs(tmp_path, package):
    study = new(tmp_path, "my-arm", "arm/arm.py", "--structure", "dynamics")
    change(study, (r"# files = \[\]", 'files = ["arm.xml"]'), (r"test_runs = \d+", "test_runs = 2"), (r"\nstates = \d+", "\nstates = 200"))
    metafmu("sample", study, "--out", tmp_path / "out")
    rows = np.genfromtxt(tmp_path / "out" / "test.csv", delimiter=",", names=True)
    assert np.ptp(rows["tipz"]) > 0.1
    # by the equations, too, without MuJoCo's steps
    program = subprocess.Popen([sys.executable, "arm.py"], cwd=study.parent, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    joints = ("turn", "shoulder", "elbow")
    states = {name: [0.1] for name in (*joints, *(f"{name}.rate" for name in joints))}
    request = {"id": 1, "request": "equations", "parameters": {"payload.mass": [0.5]}, "outputs": ["tip.z"]}
    request |= {"states": states, "inputs": {f"{name}.motor": [0.2] for name in joints}}
    output, _ = program.communicate(json.dumps(request) + "\n")
    reply = json.loads(output)
    assert reply["derivatives"]["turn"] == [0.1] and np.isfinite(reply["derivatives"]["elbow.rate"]).all()


def test_a_flexible_cable_in_exudyn_is_sampled(tmp_path, package):
    study = new(tmp_path, "my-cable", "cable.py")
    change(study, (r"\nruns = \d+", "\nruns = 4"), (r"test_runs = \d+", "test_runs = 2"))
    metafmu("sample", study, "--out", tmp_path / "out")
    rows = np.genfromtxt(tmp_path / "out" / "test.csv", delimiter=",", names=True)
    # it begins straight, and keeps its length as far as it bends
    begin = rows[rows["time"] == 0]
    assert np.abs(begin["tipx"] - begin["length"]).max() < 1e-12 and np.abs(begin["tipy"]).max() < 1e-12
    assert (np.hypot(rows["tipx"], rows["tipy"]) < 1.001 * rows["length"]).all() and rows["tipy"].min() < -0.1


def reduced_crank(model, times, crank, rod, speed):
    """Position and speed of the slider and speed of the crank by conservation of energy, which Exudyn knows nothing of."""
    count = 256
    angles, waves = 2 * np.pi * np.arange(count) / count, np.fft.rfftfreq(count, 1 / count)
    pin = np.array([0 * angles, crank * np.cos(angles), crank * np.sin(angles)])
    toward = model.OFFSET[:, None] - pin
    along = -model.GUIDE @ toward + np.sqrt((model.GUIDE @ toward) ** 2 - (toward**2).sum(0) + rod**2)
    # functions of the angle are periodic, and their Fourier series exact to rounding
    slope = lambda values: np.fft.irfft(1j * waves * np.fft.rfft(values), count)
    pin_slope, along_slope = np.array([slope(row) for row in pin]), slope(along)
    slider_slope = model.GUIDE[:, None] * along_slope
    slender = ((pin_slope**2).sum(0) + (pin_slope * slider_slope).sum(0) + (slider_slope**2).sum(0)) / 3
    inertia = model.ROTOR_INERTIA + model.ROD_MASS * slender + model.SLIDER_MASS * along_slope**2
    potential = model.ROD_MASS * 9.81 * pin[2] / 2

    def at(values, angle):
        terms = np.fft.rfft(values) / count
        terms[1:] *= 2
        return (terms * np.exp(1j * np.outer(angle, waves))).sum(1).real

    energy = at(inertia, [0.0]) * speed**2 / 2 + at(potential, [0.0])
    rate = lambda _, angle: np.sqrt(2 * (energy - at(potential, angle)) / at(inertia, angle))
    angle = solve_ivp(rate, (0, times[-1]), [0.0], "DOP853", times, rtol=1e-11, atol=1e-11).y[0]
    return at(along, angle), at(along_slope, angle) * rate(0, angle), rate(0, angle)


def test_a_spatial_slider_crank_in_exudyn_conserves_its_energy(tmp_path, package):
    study = new(tmp_path, "my-crank", "spatial_crank.py")
    change(study, (r"\nruns = \d+", "\nruns = 4"), (r"test_runs = \d+", "test_runs = 3"))
    metafmu("sample", study, "--out", tmp_path / "out")
    rows = np.genfromtxt(tmp_path / "out" / "test.csv", delimiter=",", names=True)
    # constants of the model, without what it imports
    constants = (COMMANDS / "spatial_crank.py").read_text().split("GRAVITY = ")[1].split("STEPS_PER_ROW")[0]
    model = types.SimpleNamespace()
    exec("GRAVITY = " + constants, {"np": np}, vars(model))
    for run in range(3):
        found = rows[rows["run"] == run]
        expected = reduced_crank(model, found["time"], *(found[name][0] for name in ("crank", "rod", "speed")))
        for name, values in zip(("slider", "sliderspeed", "crankspeed"), expected):
            assert np.abs(found[name] - values).max() < 3e-4 * np.ptp(values), name
