"""Runs an FMU or SSP in a host and prints every row as JSON, in a separate process: a crash of the host must not end the tests.

Usage: run_host.py HOST REQUEST, the request being the JSON of the arguments of the host's function below.
A row is the time and the outputs; the first is that of the start time. `inputs` has the values of an input in each step, by its name.
"""

import ctypes
import json
import sys
from pathlib import Path


def load_ecospy():
    """ecospy's library needs oneTBB, which its package does not bring; PyPI's `tbb` puts it where no loader looks."""
    ctypes.CDLL(str(Path(sys.prefix) / "lib" / "libtbb.so.12"), ctypes.RTLD_GLOBAL)
    import ecospy

    return ecospy


def run_ecospy(fmu, start_values, outputs, step, steps, inputs={}):
    """One FMU."""
    ecospy = load_ecospy()
    with ecospy.EcosSimulationStructure() as structure:
        structure.add_model("fmu", fmu)
        structure.add_parameter_set("start", {f"fmu::{name}": value for name, value in start_values.items()})
        with ecospy.EcosSimulation(structure=structure, step_size=step) as simulation:
            inputs = {f"fmu::{name}": values for name, values in inputs.items()}
            return step_ecospy(simulation, "start", [f"fmu::{output}" for output in outputs], steps, inputs)


def run_ecospy_ssp(ssp, outputs, step, steps):
    """A system of FMUs."""
    with load_ecospy().EcosSimulation(ssp_path=ssp, step_size=step) as simulation:
        return step_ecospy(simulation, None, outputs, steps)


def step_ecospy(simulation, parameter_set, outputs, steps, inputs={}):
    """Everything is initialized before the first step; the time is added up step by step."""
    assert simulation.init(parameter_set=parameter_set)
    rows = []
    for index in range(steps + 1):
        rows.append([simulation.get_time(), *(simulation.get_real(output) for output in outputs)])
        if index < steps:
            for name, values in inputs.items():
                simulation.set_real(name, values[index])
            simulation.step()
    simulation.terminate()
    return rows


def run_libcosimpy(fmu, start_values, outputs, step, steps, inputs={}):
    """Initializes with the first step; the outputs before it come from an observer. Times are whole nanoseconds."""
    from fmpy import read_model_description
    from libcosimpy.CosimEnums import CosimVariableType
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimManipulator import CosimManipulator
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.WARNING)
    references = {variable.name: variable.valueReference for variable in read_model_description(fmu).modelVariables}
    nanoseconds = round(step * 1e9)
    execution = CosimExecution.from_step_size(nanoseconds)
    slave = execution.add_local_slave(CosimLocalSlave(fmu, "fmu"))
    assert slave >= 0
    for name, value in start_values.items():
        assert execution.real_initial_value(slave, references[name], value)
    observer = CosimObserver.create_time_series(steps + 1)
    execution.add_observer(observer)
    for output in outputs:
        assert observer.start_time_series(slave, references[output], CosimVariableType.REAL)
    if inputs:
        manipulator = CosimManipulator.create_override()
        execution.add_manipulator(manipulator)
        for index in range(steps):
            values = [values[index] for values in inputs.values()]
            assert manipulator.slave_real_values(slave, [references[name] for name in inputs], values)
            assert execution.step()
    assert execution.simulate_until(nanoseconds * steps)
    columns = []
    for output in outputs:
        # it takes the number of step 0 for the end of the list: of two samples it returns that of step 0
        first = observer.time_series_real_samples(slave, references[output], 0, 2)
        later = observer.time_series_real_samples(slave, references[output], 1, steps)
        times = [time * 1e-9 for time in first[0] + later[0]]
        columns.append(first[2] + later[2])
    return list(zip(times, *columns))


HOSTS = {"ecospy": run_ecospy, "ecospy-ssp": run_ecospy_ssp, "libcosimpy": run_libcosimpy}

if __name__ == "__main__":
    host, request = sys.argv[1:]
    # libraries of hosts log to stdout too: the rows are its last line
    print("\n" + json.dumps(HOSTS[host](**json.loads(request))))
