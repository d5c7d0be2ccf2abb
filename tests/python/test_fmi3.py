"""FMI 2.0 and 3.0, co-simulation and model exchange: the same results from one network, judged by fmpy."""

import json
import re
import zipfile

import numpy as np
import pandas as pd
import pytest
from conftest import ANY, CASES, ROOT, changed, fmu_of, metafmu
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu

OUTPUTS = ["theta", "thetad", "thetadd"]
KINDS = [("fmi2", "CoSimulation"), ("fmi2", "ModelExchange"), ("fmi3", "CoSimulation"), ("fmi3", "ModelExchange")]


@pytest.fixture(scope="module")
def both(pendulum):
    """The pendulum's FMUs of both versions, of the network that is trained already."""
    metafmu("export", "examples/single-pendulum.toml", "--out", pendulum.folder, "--fmi", "both")
    return {f"fmi{version}": fmu for version, fmu in pendulum.fmus.items()}


def simulate(fmu, interface, case, **options):
    start_values = dict(zip(["L", "c", "thetad0"], case))
    options = {"output": OUTPUTS, "stop_time": 2.0, "output_interval": 0.01} | options
    if interface == "ModelExchange":
        options |= {"solver": "CVode", "relative_tolerance": 1e-8}
    return simulate_fmu(fmu, fmi_type=interface, start_values=start_values, **options)


def table(result):
    return np.stack([result[output] for output in OUTPUTS])


@pytest.mark.parametrize("version", ["fmi2", "fmi3"])
def test_validation_has_no_finding(both, version):
    assert validate_fmu(both[version]) == []
    report = json.loads(metafmu("validate", both[version], "--json").stdout)
    assert report == {"problems": [], "not_checked": [], "was_run": True}


@pytest.mark.parametrize("case", CASES)
def test_versions_and_interfaces_agree(both, case):
    results = {kind: simulate(both[kind[0]], kind[1], case) for kind in KINDS}
    first = results[KINDS[0]]
    for kind, result in results.items():
        np.testing.assert_allclose(result["time"], first["time"], rtol=0, atol=1e-9, err_msg=str(kind))
        np.testing.assert_allclose(table(result), table(first), rtol=1e-7, atol=1e-7, err_msg=str(kind))


@pytest.mark.parametrize("version", ["fmi2", "fmi3"])
@pytest.mark.parametrize("interval", [0.003, 0.01, 0.7])
def test_outputs_do_not_depend_on_the_step_size(both, version, interval):
    """Steps that do not divide the stop time end in a shorter one."""
    coarse = simulate(both[version], "CoSimulation", CASES[0], output_interval=interval)
    for row in coarse:
        fine = simulate(both[version], "CoSimulation", CASES[0], stop_time=row["time"] or 0.01, output_interval=0.01)
        expected = fine[-1] if row["time"] else fine[0]
        for output in OUTPUTS:
            assert abs(row[output] - expected[output]) < 1e-9
        if interval == 0.003 and row["time"] > 0.05:
            break


@pytest.fixture(scope="module")
def tunable(tmp_path_factory):
    """FMUs of both versions of a small study whose `L` is tunable."""
    folder = tmp_path_factory.mktemp("tunable")
    study = changed(
        "single-pendulum.toml",
        ('unit = "m", ', 'unit = "m", variability = "tunable", '),
        ("runs = 1331", "runs = 20"),
        ("runs = 1000", "runs = 100"),
        ("test_runs = 200", "test_runs = 5"),
        ("hidden = [64, 64, 64, 64, 64, 64]", "hidden = [16]"),
        ("epochs = 150", "epochs = 2"),
    )
    (folder / "study.toml").write_text(study)
    metafmu("build", folder / "study.toml", "--out", folder, "--fmi", "both", check=False)
    return {f"fmi{version}": fmu_of(folder, "single-pendulum", version) for version in (2, 3)}


@pytest.mark.parametrize("version,interface", KINDS)
def test_a_tunable_parameter_may_change_while_the_simulation_runs_and_the_domain_is_left(
    tunable, version, interface, capsys
):
    """fmpy sets a tunable parameter like an input: at events, and in co-simulation between steps.

    It prints what the FMU logs. No test gives `simulate_fmu` a separate logger: it stays the logger of every later FMI 2.0 simulation of
    the process, although it is freed, and what calls it then crashes.
    """
    dtype = [("time", float), ("L", float)]
    changes = np.array([(0.0, 0.12), (1.0, 0.12), (1.0, 0.18), (2.0, 0.18)], dtype=dtype)
    changed = simulate(
        tunable[version],
        interface,
        (0.12, 0.05, 2.5),
        input=changes,
        output=[*OUTPUTS, "in_domain"],
        debug_logging=True,
    )
    before, after = (simulate(tunable[version], interface, (length, 0.05, 2.5)) for length in (0.12, 0.18))
    times = np.asarray(changed["time"])
    assert changed["in_domain"][times < 0.985].all() and not changed["in_domain"][times > 1.015].any()
    assert capsys.readouterr().out.count("changed from 0.12 to 0.18 during the run") == 1
    # the row at the event itself may be of either side
    for result, rows in ((before, times < 0.985), (after, times > 1.015)):
        for output in OUTPUTS:
            expected = np.interp(times[rows], result["time"], result[output])
            np.testing.assert_allclose(changed[output][rows], expected, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("version,interface", [("fmi2", "cs"), ("fmi2", "me"), ("fmi3", "cs"), ("fmi3", "me")])
def test_metafmus_host_agrees_with_fmpy(both, version, interface, tmp_path):
    starts = [f"--start={name}={value}" for name, value in zip(["L", "c", "thetad0"], CASES[1])]
    output = tmp_path / "run.csv"
    metafmu("simulate", both[version], *starts, "--interface", interface, "--output", output)
    run = pd.read_csv(output)
    expected = simulate(both["fmi2"], "CoSimulation", CASES[1])
    for name in OUTPUTS:
        np.testing.assert_allclose(run[name], expected[name], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("version", ["fmi2", "fmi3"])
def test_the_reference_inside_is_what_fmpy_computes(both, version):
    with zipfile.ZipFile(both[version]) as archive:
        folder = "extra/org.metafmu/"
        options = json.loads(archive.read(folder + "reference_options.json"))
        with archive.open(folder + "reference_result.csv") as file:
            expected = pd.read_csv(file)
    result = simulate_fmu(
        both[version],
        start_time=options["start_time"],
        stop_time=options["stop_time"],
        output_interval=options["step_size"],
        start_values=options["start_values"],
        output=OUTPUTS,
    )
    assert len(result) == len(expected)
    for output in OUTPUTS:
        assert np.max(np.abs(result[output] - expected[output])) <= options["tolerances"][output]


@pytest.mark.parametrize("version,icon", [("fmi2", "model.png"), ("fmi3", "terminalsAndIcons/icon.png")])
def test_the_archive_explains_itself(both, version, icon):
    with zipfile.ZipFile(both[version]) as archive:
        names = archive.namelist()
        assert names[0] == "modelDescription.xml"
        assert {icon, "documentation/licenses/license.txt", "resources/model.safetensors"} <= set(names)
        assert archive.read(icon).startswith(b"\x89PNG") and archive.getinfo(icon).file_size < 10_000
        card = archive.read("documentation/index.html").decode()
    for piece in ["200 runs of the original model", "<code>thetadd</code>", "rad/s2", "MIT OR Apache-2.0"]:
        assert piece in card
    assert "http" not in card.replace('xmlns="http://www.w3.org/2000/svg"', ""), "the card loads nothing"
    assert both[version].stat().st_size < 2**20


@pytest.mark.parametrize("version,interface", KINDS)
def test_the_domain_of_validity_is_known_to_the_fmu(both, version, interface):
    outputs = [*OUTPUTS, "in_domain", "domain_distance"]
    inside = simulate(both[version], interface, CASES[0], output=outputs)
    assert inside["in_domain"].all() and not inside["domain_distance"].any()
    outside = simulate(both[version], interface, (0.25, 0.05, 2.5), output=outputs)
    assert not outside["in_domain"].any()
    np.testing.assert_allclose(outside["domain_distance"], 0.5, atol=1e-9)
    start_values = {"L": 0.25, "c": 0.05, "thetad0": 2.5, "domain_policy": 1}
    clamped = simulate_fmu(
        both[version], fmi_type=interface, start_values=start_values, output=OUTPUTS, stop_time=2.0, output_interval=0.01
    )
    edge = simulate(both[version], interface, (0.2, 0.05, 2.5))
    np.testing.assert_allclose(table(clamped)[:, -1], table(edge)[:, -1], rtol=1e-7, atol=1e-7)


def test_one_network_one_description(both):
    descriptions = {version: read_model_description(fmu) for version, fmu in both.items()}
    assert descriptions["fmi2"].guid == descriptions["fmi3"].instantiationToken
    names = [[variable.name for variable in description.modelVariables] for description in descriptions.values()]
    assert names[0] == names[1]
    for interface in (descriptions["fmi2"].coSimulation, descriptions["fmi2"].modelExchange):
        assert interface.providesDirectionalDerivative
    # fmpy looks for FMI 2.0's name of the attribute in FMI 3.0 as well
    with zipfile.ZipFile(both["fmi3"]) as archive:
        text = archive.read("modelDescription.xml").decode()
    assert text.count('providesDirectionalDerivatives="true" providesAdjointDerivatives="true"') == 2


def test_both_exports_are_reproducible(both, pendulum):
    before = {version: fmu.read_bytes() for version, fmu in both.items()}
    metafmu("export", "examples/single-pendulum.toml", "--out", pendulum.folder, "--fmi", "both")
    assert {version: fmu.read_bytes() for version, fmu in both.items()} == before


def test_a_platform_that_is_not_there_is_named(both, pendulum):
    result = metafmu(
        "export", "examples/single-pendulum.toml", "--out", pendulum.folder, "--platform", "amiga", check=False
    )
    assert result.returncode == 2 and "`amiga` is not known" in result.stderr and "x86_64-linux" in result.stderr


@pytest.mark.quick
def test_an_array_has_the_values_of_its_outputs(tmp_path):
    text = (ROOT / "examples" / "double-pendulum.toml").read_text()
    text = re.sub(r"(?m)^runs = \d+", "runs = 20", text)
    text = re.sub(r"(?m)^epochs = \d+", "epochs = 1", text)
    text = re.sub(r"(?m)^hidden = .*", "hidden = [4]", text)
    assert "[arrays]" not in text
    study = tmp_path / "study.toml"
    study.write_text(text + ANY + '\n[arrays]\nangles = ["theta1", "theta2"]\n')
    metafmu("build", study, "--fmi", "3", "--out", tmp_path)
    fmu = tmp_path / "double-pendulum-fmi3.fmu"
    assert validate_fmu(fmu) == []
    (array,) = (v for v in read_model_description(fmu).modelVariables if v.name == "angles")
    assert [int(dimension.start) for dimension in array.dimensions] == [2]
    result = simulate_fmu(fmu, output=["theta1", "theta2", "angles"], stop_time=1.0, output_interval=0.1)
    np.testing.assert_array_equal(result["angles"], np.stack([result["theta1"], result["theta2"]], axis=1))
