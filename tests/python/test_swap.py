"""`metafmu swap`: systems with a component's source and with another FMU in its place, against fmpy, scipy and closed forms."""

import json
import re
import shutil
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from conftest import METAFMU, ROOT, metafmu
from test_dynamics import build as build_crane

sys.path[:0] = [str(ROOT / "examples" / folder) for folder in ("embedding", "fmu-source")]
import build as embedding
import crane_control
import exchange
import master
from make_fmus import activated

STEP, STOP = 0.01, 5.0
SYSTEM = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription" xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" name="shaker">
  <ssd:System name="system">
    <ssd:Connectors>
      <ssd:Connector name="mu" kind="parameter"><ssc:Real/></ssd:Connector>
      <ssd:Connector name="stroke" kind="output"><ssc:Real/></ssd:Connector>
      <ssd:Connector name="push" kind="output"><ssc:Real/></ssd:Connector>
    </ssd:Connectors>
    <ssd:ParameterBindings>
      <ssd:ParameterBinding>
        <ssd:ParameterValues>
          <ssv:ParameterSet version="1.0" name="values">
            <ssv:Parameters>
              <ssv:Parameter name="mu"><ssv:Real value="0.5"/></ssv:Parameter>
              <ssv:Parameter name="oscillator.x0_start"><ssv:Real value="1.5"/></ssv:Parameter>
            </ssv:Parameters>
          </ssv:ParameterSet>
        </ssd:ParameterValues>
      </ssd:ParameterBinding>
    </ssd:ParameterBindings>
    <ssd:Elements>
      <ssd:Component name="oscillator" type="application/x-fmu-sharedlibrary" source="resources/oscillator.fmu">
        <ssd:Connectors>
          <ssd:Connector name="mu" kind="parameter"><ssc:Real/></ssd:Connector>
          <ssd:Connector name="x0" kind="output"><ssc:Real/></ssd:Connector>
        </ssd:Connectors>
      </ssd:Component>
      <ssd:Component name="load" source="resources/load.fmu">
        <ssd:Connectors>
          <ssd:Connector name="acceleration" kind="input"><ssc:Real/></ssd:Connector>
          <ssd:Connector name="displacement" kind="output"><ssc:Real unit="m"/></ssd:Connector>
          <ssd:Connector name="force" kind="output"><ssc:Real/></ssd:Connector>
        </ssd:Connectors>
        <ssd:ParameterBindings>
          <ssd:ParameterBinding prefix="displace">
            <ssd:ParameterValues>
              <ssv:ParameterSet version="1.0" name="start">
                <ssv:Parameters>
                  <ssv:Parameter name="ment"><ssv:Real value="0.02" unit="m"/></ssv:Parameter>
                </ssv:Parameters>
              </ssv:ParameterSet>
            </ssd:ParameterValues>
          </ssd:ParameterBinding>
        </ssd:ParameterBindings>
      </ssd:Component>
    </ssd:Elements>
    <ssd:Connections>
      <ssd:Connection startConnector="mu" endElement="oscillator" endConnector="mu"/>
      <ssd:Connection startElement="oscillator" startConnector="x0" endElement="load" endConnector="acceleration"/>
      <ssd:Connection startElement="load" startConnector="displacement" endConnector="stroke"/>
      <ssd:Connection startElement="load" startConnector="force" endConnector="push"/>
    </ssd:Connections>
  </ssd:System>
  <ssd:DefaultExperiment startTime="0" stopTime="5"/>
</ssd:SystemStructureDescription>
"""
# a parameter with a different name does not take the value of the source's
SOFTER = [('name="stiffness"', 'name="k"'), ('start="4000"', 'start="3900"')]
LOAD_CODE = [("[STIFFNESS] = 4000.0", "[STIFFNESS] = 3900.0")]
FASTER = [('name="k"', 'name="rate"'), ('start="1" min="0.5"', 'start="2" min="0.5"')]
# its initial displacement is a parameter, as in a surrogate
STATE = [
    ('name="displacement" valueReference="4" description="displacement of the load relative to the carriage" causality="output" '
     'variability="continuous" initial="exact">\n      <Real unit="m" start="0"/>',
     'name="displacement" valueReference="4" causality="output" variability="continuous" initial="calculated">\n      <Real unit="m"/>'),
    ('  </ModelVariables>',
     '    <ScalarVariable name="displacement_start" valueReference="4" causality="parameter" variability="fixed" initial="exact">\n'
     '      <Real unit="m" start="0"/>\n    </ScalarVariable>\n  </ModelVariables>'),
]


def rewritten(fmu, copy, changes, source_file=None, code=(), options=()):
    """A copy of an FMU with changes in its description, and a library of other code if there is a source file."""
    with zipfile.ZipFile(fmu) as source, zipfile.ZipFile(copy, "w", zipfile.ZIP_DEFLATED) as target:
        for entry in source.namelist():
            content = source.read(entry)
            if entry == "modelDescription.xml":
                content = replaced(content.decode(), changes).encode()
            elif source_file and entry.endswith(".so"):
                library, written = copy.with_suffix(".so"), copy.with_suffix(".c")
                written.write_text(replaced(source_file.read_text(), code))
                subprocess.run(["cc", "-std=c99", "-shared", "-fPIC", *options, "-o", library, written, "-lm"], check=True)
                content = library.read_bytes()
            target.writestr(entry, content)
    return copy


def replaced(text, changes):
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return text


def changed(*changes):
    return replaced(SYSTEM, changes)


@pytest.fixture(scope="module")
def shaker(tmp_path_factory):
    """A folder with a system of an oscillator, to be integrated by the host, and a load that it shakes."""
    folder = tmp_path_factory.mktemp("shaker")
    (folder / "resources").mkdir()
    load = folder / "resources" / "load.fmu"
    embedding.build_load(load)
    for version in (2, 3):
        exchange.build("van_der_pol", version, folder)
    shutil.copy(folder / "van_der_pol-fmi2.fmu", folder / "resources" / "oscillator.fmu")
    source = ROOT / "examples" / "embedding" / "load" / "load.c"
    rewritten(load, folder / "softer.fmu", [*SOFTER, *STATE], source, LOAD_CODE)
    rewritten(load, folder / "same.fmu", STATE)
    rewritten(load, folder / "without-start.fmu", STATE[:1])
    (folder / "SystemStructure.ssd").write_text(SYSTEM)
    return folder


def bound(*values):
    """The values of a system's parameters, by names."""
    parameter = '<ssv:Parameter name="{}"><ssv:Real value="{}"/></ssv:Parameter>'
    parameters = "".join(parameter.format(*value) for value in values)
    namespace = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
    parameter_set = f'<ssv:ParameterSet xmlns:ssv="{namespace}" version="1.0" name="values"><ssv:Parameters>{parameters}'
    tags = ["ParameterBindings", "ParameterBinding", "ParameterValues"]
    begin, end = ("".join(f"<{slash}ssd:{tag}>" for tag in order) for slash, order in [("", tags), ("/", tags[::-1])])
    return f"{begin}{parameter_set}</ssv:Parameters></ssv:ParameterSet>{end}"


def swap(system, component, surrogate, *options, env=None):
    """The comparison, and what was said."""
    command = [METAFMU, "swap", system, "--component", component, "--with", surrogate, "--json", *options]
    result = subprocess.run(list(map(str, command)), capture_output=True, text=True, env=env)
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout), result.stderr


def shaken(fmu, stiffness, start=0.02):
    """Displacement and force by fmpy, which steps the FMU under the exact oscillator."""
    times = STEP * np.arange(round(STOP / STEP) + 1)
    acceleration = exchange.van_der_pol(times, 0.5, 1.5)["x0"]
    load = master.Component(fmu, "load")
    load.set(*stiffness)
    load.set("displacement", start)
    load.initialize()
    rows = [load.get("displacement", "force")]
    for time, value in zip(times[:-1], acceleration):
        load.set("acceleration", value)
        load.slave.doStep(time, STEP)
        rows.append(load.get("displacement", "force"))
    load.close()
    return np.array(rows).T


def differences(comparison):
    return {output["output"]: output for output in comparison["outputs"]}


@pytest.mark.parametrize("version", [2, 3])
def test_an_identical_fmu_makes_no_difference(version, shaker):
    comparison, said = swap(shaker / "SystemStructure.ssd", "oscillator", shaker / f"van_der_pol-fmi{version}.fmu")
    found = differences(comparison)
    assert list(found) == ["stroke", "push"] and found["stroke"]["unit"] == "m"
    # the oscillator's step size
    assert (comparison["step"], comparison["steps"], comparison["stop"]) == (0.02, 250, STOP)
    for output in found.values():
        assert output["rms"] == output["max"] == 0.0 and output["range"] > 0.0
    assert "warning" not in said


def test_another_fmu_makes_the_difference_that_it_makes_in_fmpy(shaker):
    load = shaker / "resources" / "load.fmu"
    expected, softer = (shaken(load, ("stiffness", value)) for value in (4000.0, 3900.0))
    comparison, said = swap(shaker / "SystemStructure.ssd", "load", shaker / "softer.fmu", "--default", "k", "--step-size", STEP)
    for name, one, other in zip(["stroke", "push"], expected, softer):
        found = differences(comparison)[name]
        difference = np.abs(one - other)
        scale = np.ptp(one)
        assert abs(found["range"] / scale - 1) < 1e-7
        assert abs(found["rms"] - np.sqrt(np.mean(difference**2))) < 1e-7 * scale
        assert abs(found["max"] - np.max(difference)) < 1e-7 * scale
        assert abs(found["relative_max"] - np.max(difference) / scale) < 1e-7
        assert found["max"] > 0.01 * scale
    assert "warning" not in said


def test_states_start_where_those_of_the_source_do(shaker):
    comparison, said = swap(shaker / "SystemStructure.ssd", "load", shaker / "same.fmu", "--step-size", STEP)
    assert all(output["max"] == 0.0 for output in comparison["outputs"]) and "warning" not in said
    comparison, said = swap(shaker / "SystemStructure.ssd", "load", shaker / "without-start.fmu", "--step-size", STEP)
    first = differences(comparison)["stroke"]
    assert first["max"] == pytest.approx(0.02) and first["max_time"] == 0.0
    assert "warning: the system sets `displacement` to 0.02, which the surrogate has no parameter for" in said


def test_parameters_that_the_source_lacks_need_a_default(shaker):
    arguments = ["swap", shaker / "SystemStructure.ssd", "--component", "load", "--with", shaker / "softer.fmu", "--step-size", STEP]
    result = metafmu(*arguments, check=False)
    says = "the source has no input or parameter `k`, expected it among mass, stiffness, damping, acceleration"
    assert result.returncode == 2 and says in result.stderr and result.stderr.endswith("; for constants: --default k=3900.0\n"), result.stderr
    assert "start values requested by --default: k = 3950" in metafmu(*arguments, "--default", "k=3950").stderr


def test_start_values_are_printed_with_their_origin(shaker):
    comparison, said = swap(shaker / "SystemStructure.ssd", "oscillator", shaker / "van_der_pol-fmi3.fmu")
    values = {value["name"]: (value["value"], value["origin"]) for value in comparison["start_values"]}
    assert values["mu"] == (0.5, "system") and values["x0_start"] == (1.5, "system")
    lines = [line for line in said.splitlines() if line.startswith("start values ")]
    assert lines[0].startswith("start values set by the system: ") and "mu = 0.5" in lines[0] and "x0_start = 1.5" in lines[0], said
    others = [name for name, (_, origin) in values.items() if origin != "system"]
    assert all(any(f"{name} = " in line for line in lines) for name in others)


def test_archives_tables_and_plots(shaker, tmp_path):
    """The system as an archive; if it has no outputs, those of the component are compared."""
    ssp, plot = tmp_path / "shaker.ssp", tmp_path / "shaker.svg"
    structure = tmp_path / "SystemStructure.ssd"
    outputs = [line for line in SYSTEM.splitlines(True) if 'endConnector="stroke"' in line or 'endConnector="push"' in line]
    structure.write_text(changed(*((line, "") for line in outputs)))
    resources = shaker / "resources"
    fmus = {"oscillator.fmu": resources / "oscillator.fmu", "load.fmu": resources / "load.fmu"}
    embedding.build_ssp(structure, ssp, fmus)
    arguments = ["--component", "load", "--with", shaker / "softer.fmu", "--default", "k", "--step", STEP]
    result = metafmu("swap", ssp, *arguments, "--plot", plot)
    lines = result.stdout.splitlines()
    assert lines[0].startswith("shaker: load is") and lines[0].endswith("500 steps of 0.01 s")
    assert [line.split()[0] for line in lines[3:5]] == ["load.displacement", "load.force"]
    assert [line[:10].strip() for line in lines[7:9]] == ["load", "the system"]
    svg = plot.read_text()
    for text in ["load.displacement [m]", "load.force [N]", "with the source", "with the surrogate"]:
        assert text in svg
    found, _ = swap(ssp, *arguments[1:2], *arguments[3:])
    first = found["outputs"][0]
    rms, _, largest, when, relative = re.search(r"m +(\S+) +(\S+) % +(\S+) at (\S+) s +(\S+) %", lines[3]).groups()
    assert float(rms) == pytest.approx(first["rms"], rel=1e-3) and float(largest) == pytest.approx(first["max"], rel=1e-3)
    assert float(relative) == pytest.approx(100 * first["relative_max"], abs=1e-3) and float(when) == pytest.approx(first["max_time"])
    # an FMU for co-simulation has a separate solver
    assert found["source_tolerance"] is None and lines[-1].startswith("(alternately in ") and lines[-1].endswith(" simulations of each)")
    times = found["component_step"]
    assert times["speed_up"] == pytest.approx(times["source"]["median"] / times["surrogate"]["median"])
    assert 0 < times["source"]["minimum"] <= times["source"]["median"] < 1e-2


def test_a_jacobi_master_holds_inputs_over_a_step(shaker, tmp_path):
    """x' = -k x + u by the host's integrator, u being the oscillator's output at the beginning of each step."""
    (tmp_path / "resources").mkdir()
    exchange.build("dahlquist", 2, tmp_path).rename(tmp_path / "resources" / "load.fmu")
    shutil.copy(shaker / "van_der_pol-fmi2.fmu", tmp_path / "resources" / "oscillator.fmu")
    bindings = re.search(r"        <ssd:ParameterBindings>\n          <ssd:ParameterBinding prefix.*?</ssd:ParameterBindings>\n", SYSTEM, re.DOTALL)[0]
    push = [line for line in SYSTEM.splitlines(True) if '"push"' in line or '"force"' in line]
    system = changed((bindings, ""), *((line, "") for line in push), ('"acceleration"', '"u"'), ('"displacement"', '"x"'))
    (tmp_path / "SystemStructure.ssd").write_text(system.replace(' unit="m"', ""))
    # one that decays twice as fast
    source, options = exchange.HERE / "exchange" / "exchange.c", ["-DMODEL=DAHLQUIST", "-DFMI=2"]
    code = [("{0, 1, 1, 0, 1, 0}", "{0, 2, 1, 0, 1, 0}")]
    other = rewritten(tmp_path / "resources" / "load.fmu", tmp_path / "other.fmu", FASTER, source, code, options)
    comparison, _ = swap(tmp_path / "SystemStructure.ssd", "load", other, "--default", "rate", "--step-size", 0.1)
    inputs = exchange.van_der_pol(0.1 * np.arange(51), 0.5, 1.5)["x0"]

    def solve(k):
        rows = [1.0]
        for u in inputs[:-1]:
            rows.append(rows[-1] * np.exp(-0.1 * k) + u / k * -np.expm1(-0.1 * k))
        return np.array(rows)

    one, two = solve(1.0), solve(2.0)
    (found,) = comparison["outputs"]
    assert abs(found["range"] - np.ptp(one)) < 1e-7
    assert abs(found["max"] - np.max(np.abs(one - two))) < 1e-7
    assert abs(found["rms"] - np.sqrt(np.mean((one - two) ** 2))) < 1e-7


@pytest.fixture(scope="module")
def crane(tmp_path_factory):
    """The crane's surrogate with PythonFMU's controller, as SSP, and fmpy's table of it."""
    folder = tmp_path_factory.mktemp("crane-swap")
    built = build_crane(folder / "crane")
    controller = crane_control.build_controller(folder)
    structure = ROOT / "examples" / "embedding" / "crane" / "SystemStructure.ssd"
    fmus = {"crane.fmu": built.fmu(2), "controller.fmu": controller}
    embedding.build_ssp(structure, folder / "crane.ssp", fmus)
    return folder, built, crane_control.simulate(built.fmu(2), controller)


def test_a_crane_in_its_control_loop_is_as_in_fmpy(crane):
    folder, built, table = crane
    comparison, said = swap(folder / "crane.ssp", "crane", built.fmu(3), "--step-size", crane_control.STEP, env=activated())
    assert "warning" not in said
    found = differences(comparison)
    for name, values in zip(["crane.x", "crane.theta"], table.T[1:3]):
        assert found[name]["max"] == 0.0
        assert found[name]["range"] == np.max(values) - np.min(values)


def test_a_mechanism_and_its_surrogate_move_as_by_scipy(crane, tmp_path):
    """Both start where the mechanism's parameters say; the surrogate takes its other parameters from it."""
    folder, built, _ = crane
    structure = tmp_path / "SystemStructure.ssd"
    values = bound(("crane.l", 1.2), ("crane.theta0", 0.2))
    template = ROOT / "examples" / "embedding" / "crane" / "mechanism.ssd"
    structure.write_text(replaced(template.read_text(), [("<ssd:Elements>", values + "<ssd:Elements>")]))
    files = {"crane.toml": ROOT / "examples" / "dynamics" / "crane.toml", "controller.fmu": folder / "controller.fmu"}
    embedding.build_ssp(structure, tmp_path / "mechanism.ssp", files)
    arguments = ["--step-size", crane_control.STEP, "--tolerance", 1e-12]
    comparison, said = swap(tmp_path / "mechanism.ssp", "crane", built.fmu(2), *arguments, env=activated())
    expected = crane_control.solve([1.2, 1.0, 0.0], [0.0, 0.2, 0.0, 0.0])
    found = differences(comparison)
    for name, values in zip(["crane.x", "crane.theta"], expected.T[1:3]):
        assert abs(found[name]["range"] - np.ptp(values)) < 1e-7, name
        assert 0.0 < found[name]["max"] < 1e-7, name
    # the mechanism is timed at the loosest tolerance whose differences from these runs are no larger than the surrogate's
    assert 1e-12 < comparison["source_tolerance"] <= 1e-2 and comparison["timed_simulations"] >= 1
    assert [line for line in said.splitlines() if "warning" in line] == [
        "warning: the system sets `theta0` to 0.2, which the surrogate has no parameter for"
    ]


def test_a_surrogate_outside_of_its_domain_is_a_warning(crane, tmp_path):
    folder, built, _ = crane
    structure = ROOT / "examples" / "embedding" / "crane" / "SystemStructure.ssd"
    # more than the 10 N that the surrogate is made for
    values = bound(("controller.target", 6.0), ("controller.limit", 20.0))
    far = tmp_path / "SystemStructure.ssd"
    far.write_text(replaced(structure.read_text(), [("<ssd:Elements>", values + "<ssd:Elements>")]))
    fmus = {"crane.fmu": built.fmu(2), "controller.fmu": folder / "controller.fmu"}
    embedding.build_ssp(far, tmp_path / "far.ssp", fmus)
    comparison, said = swap(tmp_path / "far.ssp", "crane", built.fmu(3), "--step-size", 0.02, env=activated())
    outside = comparison["outside_domain"]
    assert outside["rows"] > 0 and 0 < outside["first"] < 10
    assert f"at {outside['first']} s for the first time (`in_domain` is false)" in said


# what is changed, what is in the line that is named, and what is said of it
MALFORMED = {
    "not XML": (("</ssd:Elements>", "</ssd:Element>"), "</ssd:Element>", "not well-formed XML"),
    "a later version": (('version="1.0" name="shaker"', 'version="2.0" name="shaker"'), "shaker", "the version is 2.0, expected 1.0"),
    "a component of another type": (
        ("x-fmu-sharedlibrary", "x-ssp-definition"),
        "x-ssp-definition",
        "component `oscillator` is of the type `application/x-ssp-definition`, expected `application/x-fmu-sharedlibrary` or `application/toml`",
    ),
    "a system in the system": (
        ("<ssd:Elements>", '<ssd:Elements>\n<ssd:System name="inner"/>'),
        '"inner"',
        "<ssd:System> `inner` is not supported, expected components that are FMUs",
    ),
    "a transformation": (
        ('endConnector="stroke"/>', 'endConnector="stroke">\n<ssc:LinearTransformation factor="2"/></ssd:Connection>'),
        "LinearTransformation",
        "<ssc:LinearTransformation> is not supported, expected a connection without transformation",
    ),
    "a conversion of units": (
        ('name="stroke" kind="output"><ssc:Real/>', 'name="stroke" kind="output"><ssc:Real unit="mm"/>'),
        'endConnector="stroke"',
        "the connection from `displacement` in m to `stroke` in mm needs a conversion",
    ),
    "an unknown component": (
        ('startElement="oscillator"', 'startElement="oszillator"'),
        "oszillator",
        "there is no component `oszillator`, expected one of oscillator, load; did you mean `oscillator`?",
    ),
    "an unknown connector": (
        ('startConnector="force"', 'startConnector="forse"'),
        "forse",
        "component `load` has no connector `forse`, expected one of acceleration, displacement, force; did you mean `force`?",
    ),
    "a connection the wrong way": (
        ('startConnector="force"', 'startConnector="acceleration"'),
        'startConnector="acceleration"',
        "the connection's start is `acceleration`, which gives no value",
    ),
    "a value that is no number": (
        ('<ssv:Real value="1.5"/>', '<ssv:Real value="1,5"/>'),
        "1,5",
        "parameter `oscillator.x0_start` has the value `1,5`, which is no <ssv:Real>",
    ),
    "a text": (
        ('<ssv:Real value="1.5"/>', '<ssv:String value="x"/>'),
        "ssv:String",
        "parameter `oscillator.x0_start` is of the type <ssv:String>, expected a real, an integer or a boolean",
    ),
    "a variable that the FMU has not": (
        ('"oscillator.x0_start"', '"oscillator.x1_start"'),
        "x1_start",
        "component `oscillator`: it has no variable `x1_start`; did you mean `x0_start`?",
    ),
    "a connector that the FMU has not": (
        ('"force"', '"forces"'),
        'name="forces"',
        "component `load`: it has no variable `forces`; did you mean `force`?",
    ),
    "a value in another unit": (
        ('value="0.02" unit="m"', 'value="20" unit="mm"'),
        'unit="mm"',
        "component `load`: `displacement` is set in mm, expected its unit m: units are not converted",
    ),
}


@pytest.mark.parametrize("change,at,says", MALFORMED.values(), ids=MALFORMED)
def test_what_is_wrong_with_a_system_is_said_with_its_line(change, at, says, shaker, tmp_path):
    structure = shutil.copytree(shaker, tmp_path / "system") / "SystemStructure.ssd"
    text = changed(change)
    structure.write_text(text)
    result = metafmu("swap", structure, "--component", "load", "--with", shaker / "softer.fmu", check=False)
    assert result.returncode == 2 and result.stdout == ""
    (line,) = result.stderr.splitlines()
    number = next(number for number, line in enumerate(text.splitlines(), 1) if at in line)
    assert line.startswith(f"error: {structure}:{number}: {says}")


def test_all_that_is_wrong_is_said_at_once(shaker, tmp_path):
    structure = shutil.copytree(shaker, tmp_path / "system") / "SystemStructure.ssd"
    cases = ("an unknown component", "an unknown connector", "a value that is no number")
    structure.write_text(changed(*(MALFORMED[case][0] for case in cases)))
    result = metafmu("swap", structure, "--component", "load", "--with", shaker / "softer.fmu", check=False)
    assert result.returncode == 2 and len(result.stderr.splitlines()) == 3, result.stderr


def test_a_surrogate_that_does_not_fit_is_refused(shaker):
    system = shaker / "SystemStructure.ssd"
    result = metafmu("swap", system, "--component", "load", "--with", shaker / "van_der_pol-fmi3.fmu", check=False)
    assert result.returncode == 2
    for name in ("acceleration", "displacement", "force"):
        assert f"van_der_pol-fmi3.fmu: it has no variable `{name}`" in result.stderr
    result = metafmu("swap", system, "--component", "laod", "--with", shaker / "same.fmu", check=False)
    assert "there is no component `laod`, expected one of oscillator, load; did you mean `load`?" in result.stderr
    result = metafmu("swap", shaker / "same.fmu", "--component", "load", "--with", shaker / "same.fmu", check=False)
    assert "same.fmu: entry `SystemStructure.ssd`: is missing: not an SSP archive" in result.stderr
    assert result.returncode == 2


@pytest.mark.parametrize(
    "options,says",
    [
        (["--step-size", "0"], "start 0 s, stop 5 s, step 0 s: a step size above zero"),
        (["--stop-time", "0"], "start 0 s, stop 0 s, step 0.001 s: a stop time after the start time"),
        (["--time-limit", "1e-6"], "SystemStructure.ssd: when it was loaded or instantiated, it took longer than 0.000001 s"),
        (["--plot", "none/x.svg"], "none/x.svg: cannot write: there is no folder none"),
    ],
)
def test_times_and_files_that_make_no_comparison_are_refused(options, says, shaker):
    surrogate = shaker / "same.fmu"
    result = metafmu("swap", shaker / "SystemStructure.ssd", "--component", "load", "--with", surrogate, *options, check=False)
    assert (result.returncode, result.stdout) == (2, "") and says in result.stderr, result.stderr
