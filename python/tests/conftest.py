"""Common part of the tests of all frameworks: an FMU, run by fmpy, gives the predictions of the framework."""

import numpy as np
import pytest

import metafmu

fmpy = pytest.importorskip("fmpy")


def pytest_addoption(parser):
    parser.addoption("--no-skips", action="store_true", help="fail if a test is skipped, for instance because a framework is not installed")


def pytest_sessionfinish(session):
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    skipped = reporter.stats.get("skipped") if reporter else None
    if session.config.getoption("--no-skips") and skipped:
        reporter.write_line(f"\n--no-skips: {len(skipped)} skipped: {skipped[0].longrepr}", red=True)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def by_fmpy(fmu, names, outputs, rows):
    """The outputs of an FMU at rows of its inputs, and their directional derivatives along each input, by fmpy."""
    description = fmpy.read_model_description(fmu)
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    folder = fmpy.extract(fmu)
    instance = fmpy.instantiate_fmu(folder, description, "CoSimulation")
    given, wanted = [references[name] for name in names], [references[name] for name in outputs]
    is_2 = description.fmiVersion == "2.0"
    instance.instantiate() if not is_2 else None
    if is_2:
        instance.setupExperiment(startTime=0.0)
    instance.enterInitializationMode()
    instance.exitInitializationMode()
    set_values, get_values = (instance.setReal, instance.getReal) if is_2 else (instance.setFloat64, instance.getFloat64)
    found, slopes = [], []
    for row in rows:
        set_values(given, row)
        found.append(get_values(wanted))
        slopes.append([instance.getDirectionalDerivative(wanted, [along], [1.0]) for along in given])
    instance.terminate()
    instance.freeInstance()
    return np.array(found), np.array(slopes).transpose(0, 2, 1)


@pytest.fixture
def agrees(tmp_path, request):
    """Compares predictions, and both FMUs, with what is expected, relative to its range; and the FMUs' directional derivatives with the surrogate's."""

    def check(surrogate, rows, expected, tolerance):
        rows, expected = np.asarray(rows, dtype=np.float64), np.asarray(expected, dtype=np.float64)
        expected = expected.reshape(len(rows), -1)
        scale = np.ptp(expected, axis=0)
        scale = np.where(scale > 0, scale, np.maximum(np.abs(expected).max(axis=0), 1e-300))
        names, outputs = ([item.name for item in items] for items in (surrogate.inputs, surrogate.outputs))
        largest = np.max(np.abs(surrogate.predict(rows) - expected) / scale)
        some = slice(0, 20)
        jacobian = surrogate.jacobian(rows[some])
        for fmu in surrogate.export(tmp_path / "model.fmu", fmi="both"):
            found, slopes = by_fmpy(fmu, names, outputs, rows[some])
            largest = max(largest, np.max(np.abs(found - expected[some]) / scale))
            assert np.abs(slopes - jacobian).max() <= 1e-12 * np.abs(jacobian).max()
        print(f"\nLARGEST {request.node.path.stem} tolerance {tolerance:.0e} {request.node.name} {largest:.2e}")
        assert largest <= tolerance, f"{largest:.3e} of the range"

    return check


def differences(function, rows, step=1e-5):
    """Derivatives by central differences, of shape (rows, outputs, inputs)."""
    columns = []
    for column in range(rows.shape[1]):
        size = step * max(1.0, np.abs(rows[:, column]).max())
        shift = np.zeros(rows.shape[1])
        shift[column] = size
        columns.append((function(rows + shift) - function(rows - shift)).reshape(len(rows), -1) / (2 * size))
    return np.stack(columns, axis=-1)


@pytest.fixture
def rows():
    random = np.random.default_rng(1)
    x = random.uniform([-1.0, 0.5, -3.0], [1.0, 2.0, 3.0], (200, 3))
    y = np.stack([np.sin(2 * x[:, 0]) * x[:, 1] + 0.1 * x[:, 2], x[:, 1] ** 2 - np.cos(x[:, 2])], axis=1)
    return x, y


@pytest.fixture
def goes_by_names():
    """Checks a reader of a model with the columns flow and temp, in whatever way these names are given; ``knows``: whether the model knows them."""

    def check(read, predict, tolerance, knows):
        frame, _ = flow_and_temp()
        further, units = frame.assign(force=1.0), {"temp": "K", "flow": "m3/s"}
        ways = [{"data": frame}, {"data": frame, "inputs": units}, {"data": further, "inputs": units}, {"data": further, "inputs": ["temp", "flow"]}]
        if knows:
            ways += [{"data": further[["force", "temp", "flow"]]}, {"data": further[["force", "temp", "flow"]], "inputs": units},
                     {"data": frame[["temp", "flow"]]}, {"inputs": {"temp": (300, 400), "flow": (0, 1)}}]
            for wrong in ({"inputs": ["temp", "pressure"], "data": frame}, {"data": frame.rename(columns={"flow": "pressure"})}):
                with pytest.raises(metafmu.Error, match="temp.*pressure|pressure.*temp"):
                    read(**wrong)
        # names in another order, however they are spelled
        others = [{"data": frame, "inputs": ["Temp", "FLOW"]}, {"data": frame, "inputs": {"temp [K]": "K", "Flow": "m3/s"}}]
        if knows:
            others += [{"inputs": {"Temp": (300, 400), "Flow": (0, 1)}}, {"data": frame[["temp", "flow"]].rename(columns=str.upper)}]
        for wrong in others:
            with pytest.raises(metafmu.Error, match="(?i)the order of .* is temp.*, flow, that of .* flow, temp: by position"):
                read(**wrong)
        spelled = read(inputs=["Flow", "TEMP"], data=frame)
        assert [(item.name, item.max) for item in spelled.inputs] == [("Flow", frame.flow.max()), ("TEMP", frame.temp.max())]
        with pytest.raises(metafmu.Error, match=r"inputs.flow: \d+ % of the rows of training data are outside of its range from 300 to 400"):
            read(data=frame, inputs={"flow": (300, 400), "temp": (0, 1)})
        for way in ways:
            surrogate = read(**way)
            expected = np.reshape(predict(frame), (60, -1))
            assert [item.name for item in surrogate.inputs] == ["flow", "temp"] and surrogate.inputs[1].max > 390, way
            assert np.abs(surrogate.predict(further) - expected).max() <= tolerance * np.ptp(expected), way
        renamed = read(inputs=["a", "b"], data=frame)
        assert [(item.name, item.max) for item in renamed.inputs] == [("a", frame.flow.max()), ("b", frame.temp.max())]

    return check


def flow_and_temp():
    """A DataFrame with these columns, and what follows from them."""
    pandas = pytest.importorskip("pandas")
    random = np.random.default_rng(0)
    frame = pandas.DataFrame({"flow": random.uniform(0, 1, 60), "temp": random.uniform(300, 400, 60)})
    return frame, 100 * frame.flow + 2 * frame.temp
