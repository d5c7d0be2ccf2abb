"""The schemas that `metafmu schema` prints, and the reference pages made from them."""

import importlib.util
import tomllib

import jsonschema
import pytest
from conftest import ROOT

specification = importlib.util.spec_from_file_location("reference", ROOT / "scripts" / "reference.py")
reference = importlib.util.module_from_spec(specification)
specification.loader.exec_module(reference)

EXAMPLES = sorted((ROOT / "examples").rglob("*.toml"))
KINDS = {path: "mechanism" if "bodies" in tomllib.loads(path.read_text()) else "study" for path in EXAMPLES}
STUDY = (ROOT / "examples" / "single-pendulum.toml").read_text()
MECHANISM = (ROOT / "examples" / "mechanisms" / "single-pendulum.toml").read_text()


@pytest.fixture(scope="module")
def validators():
    schemas = {kind: reference.schema(kind) for kind in ("study", "mechanism")}
    for schema in schemas.values():
        jsonschema.Draft7Validator.check_schema(schema)
    return {kind: jsonschema.Draft7Validator(schema) for kind, schema in schemas.items()}


def test_there_are_examples_of_both_kinds():
    assert sum(kind == "study" for kind in KINDS.values()) >= 10
    assert sum(kind == "mechanism" for kind in KINDS.values()) >= 6


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_example_is_accepted(validators, path):
    errors = validators[KINDS[path]].iter_errors(tomllib.loads(path.read_text()))
    assert [error.message for error in errors] == []


@pytest.mark.parametrize(
    ("kind", "good", "bad", "path"),
    [
        ("study", "[time]", "[time]\nmargn = 0.1", ["time"]),
        ("study", "[time]", "[tim]", []),
        ("study", "stop = 2.0", 'stop = "2"', ["time", "stop"]),
        ("study", "seed = 1", "seed = -1", ["seed"]),
        ("study", 'method = "sobol"', 'method = "grid"', ["sampling", "method"]),
        ("study", "test_runs = 200", "test_runs = 1.5", ["sampling", "test_runs"]),
        ("study", "[outputs]\n", "[outputs]\nalpha = 3\n", ["outputs", "alpha"]),
        ("study", "[export]", '[baselines]\nmodels = ["rigde"]\n[export]', ["baselines", "models", 0]),
        ("study", "test_runs = 200", "test_runs = 0", ["sampling", "test_runs"]),
        ("study", "stop = 2.0", "stop = 0", ["time", "stop"]),
        ("study", "[export]", "[accept]\nr2 = 1\n[export]", ["accept", "r2"]),
        ("study", "[export]", "[baselines.ridge]\nalpha = -1\n[export]", ["baselines", "ridge", "alpha"]),
        ("study", "[export]", "[baselines.ridge]\nlambda = 1\n[export]", ["baselines", "ridge"]),
        ("study", "[export]", "[search]\ntrials = 2\n[search.space]\nseed = 3\n[export]", ["search", "space", "seed"]),
        ("mechanism", '[bodies.rod]', "[bodies.rod]\nmas = 1", ["bodies", "rod"]),
        ("mechanism", 'mass = "m"', "mass = true", ["bodies", "rod", "mass"]),
        ("mechanism", 'mass = "m"', "mass = -1", ["bodies", "rod", "mass"]),
        ("mechanism", '"revolute"', '"hinge"', ["joints", "pivot", "type"]),
        ("mechanism", '[0, "-g"]', '[0, 0, "-g"]', ["gravity"]),
        ("mechanism", 'type = "revolute"', "", ["joints", "pivot"]),
    ],
)
def test_unknown_keys_and_wrong_types_are_refused_where_they_are(validators, kind, good, bad, path):
    text = STUDY if kind == "study" else MECHANISM
    assert good in text
    errors = list(validators[kind].iter_errors(tomllib.loads(text.replace(good, bad, 1))))
    assert [list(error.absolute_path) for error in errors][:1] == [path], errors


@pytest.mark.parametrize(("kind", "page"), [("study", "study-file.md"), ("mechanism", "mechanism-file.md")])
def test_the_reference_page_has_every_key(kind, page):
    assert reference.document(kind) == (ROOT / "docs" / page).read_text()
