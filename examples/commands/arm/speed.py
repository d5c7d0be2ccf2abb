"""Prints the time of MuJoCo's steps alone for a simulated second, without Python between them: `python speed.py`."""

import time
from pathlib import Path

import mujoco

for contact in (False, True):
    spec = mujoco.MjSpec.from_file(str(Path(__file__).with_name("arm.xml")))
    if not contact:
        spec.geom("floor").contype = spec.geom("floor").conaffinity = 0
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model = spec.compile()
    data = mujoco.MjData(model)
    times = []
    for _ in range(5):
        mujoco.mj_resetData(model, data)
        begin = time.perf_counter()
        mujoco.mj_step(model, data, nstep=1000)
        times.append((time.perf_counter() - begin) / (1000 * model.opt.timestep))
    print(f"{'with' if contact else 'without'} contact: {1e3 * min(times):.2f} ms for a simulated second")
