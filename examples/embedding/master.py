"""The slider crank's surrogate moves a load: a co-simulation master of a few lines, with fmpy.

The coupling is of the Jacobi kind: both FMUs step over the same interval, and the load keeps the slider's acceleration of
the interval's beginning. Its error is of the order of the step size. The load does not act back, for the crank's motion is
prescribed.

Usage: master.py SLIDER_CRANK.fmu LOAD.fmu > RESULT.csv
"""

import contextlib
import shutil
import sys

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave


class Component:
    """An instance whose variables have names."""

    def __init__(self, fmu, name):
        description = read_model_description(fmu)
        self.references = {variable.name: variable.valueReference for variable in description.modelVariables}
        self.folder = extract(fmu)
        self.slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=self.folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.slave.instantiate()

    def initialize(self):
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def set(self, name, value):
        self.slave.setReal([self.references[name]], [value])

    def get(self, *names):
        return self.slave.getReal([self.references[name] for name in names])

    def close(self):
        self.slave.terminate()
        self.slave.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)


def simulate(slider_crank, load, stop=5.0, step=1e-3, parameters=None):
    """A table with a row for each communication point: time, xB, xBdd, displacement, force."""
    with contextlib.ExitStack() as stack:
        slider, load = Component(slider_crank, "slider_crank"), Component(load, "load")
        stack.callback(slider.close)
        stack.callback(load.close)
        for name, value in (parameters or {}).items():
            slider.set(name, value)
        for component in (slider, load):
            component.initialize()

        rows = [[0.0, *slider.get("xB", "xBdd"), *load.get("displacement", "force")]]
        for index in range(round(stop / step)):
            load.set("acceleration", slider.get("xBdd")[0])
            for component in (slider, load):
                component.slave.doStep(index * step, step)
            rows.append([(index + 1) * step, *slider.get("xB", "xBdd"), *load.get("displacement", "force")])
    return np.array(rows)


if __name__ == "__main__":
    table = simulate(*sys.argv[1:])
    np.savetxt(sys.stdout, table, "%.17g", ",", header="time,xB,xBdd,displacement,force", comments="")
