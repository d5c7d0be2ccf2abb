"""The released command, and the single pendulum built once by it, for every test here."""

import csv
import fcntl
import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.build import build_platform_binary
from scipy.integrate import solve_ivp
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

# of a browser, (width, height) in CSS pixels
DESKTOP, PHONE = (1440, 900), (390, 844)
ROOT = Path(__file__).resolve().parents[2]
METAFMU = ROOT / "target" / "release" / "metafmu"
IS_WORKER = "PYTEST_XDIST_WORKER" in os.environ
if IS_WORKER:
    # there are as many workers as cores
    os.environ.setdefault("RAYON_NUM_THREADS", "1")
# not as many threads as the others have
OTHER_THREADS = {"RAYON_NUM_THREADS": "2" if os.environ.get("RAYON_NUM_THREADS") == "1" else "1"}
# accepts whatever little training gives
ANY = "\n[accept]\nr2 = -inf\nbaseline_factor = inf\nangle_error = inf\n"
# the end of a study of runs, whose training takes no time
SMALL = """[sampling]
method = "sobol"
runs = 60
test_runs = 10
[network]
hidden = [8]
[training]
epochs = 2
"""
PARAMETERS = ["L", "c", "thetad0"]
OUTPUTS = ["theta", "thetad", "thetadd"]

# (L, c, thetad0): the named test cases of Choi et al. 2021, section 4.1
CASES = [
    (0.1911, 0.055, 3.78),
    (0.123, 0.055, 2.53),
    (0.1583, 0.055, 0.52),
    (0.1758, 0.109, 0.52),
    (0.1911, 0.109, 4.52),
]


def fmu_of(folder, name, version):
    """The FMU of a study or baseline in a folder of results."""
    return folder / (f"{name}-fmi3.fmu" if int(version) == 3 else f"{name}.fmu")


# folder of the library by digest of the sources and flags: tests of a file compile the same ones
COMPILED = {}


def compiled_from_sources(packed, monkeypatch, flags=""):
    """Unpacked folder of an FMU whose library is compiled from its sources with these flags, without any other file that it could read."""
    # fmpy calls the cmake that was installed beside it
    monkeypatch.setenv("PATH", os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    unpacked = Path(fmpy.extract(str(packed)))
    # the weights are compiled in: neither library nor model file is needed
    shutil.rmtree(unpacked / "binaries")
    shutil.rmtree(unpacked / "resources")
    sources = sorted(path for path in (unpacked / "sources").rglob("*") if path.is_file())
    content = b"".join(path.name.encode() + path.read_bytes() for path in [unpacked / "modelDescription.xml", *sources])
    digest = hashlib.sha256(flags.encode() + content).digest()
    if digest in COMPILED:
        shutil.copytree(COMPILED[digest], unpacked / "binaries")
    else:
        build_platform_binary(unpacked, all_warnings=True, cmake_options={"CMAKE_C_FLAGS": flags})
        COMPILED[digest] = unpacked / "binaries"
    return unpacked


@dataclass
class Build:
    folder: Path
    fmu: Path
    metrics: dict

    @property
    def fmus(self):
        """The FMU of each FMI version."""
        return {version: fmu_of(self.folder, self.fmu.stem, version) for version in (2, 3)}


def metafmu(*arguments, check=True, cwd=ROOT):
    """Runs the command and returns what it printed."""
    assert METAFMU.exists(), "run `cargo build --release` first"
    command = [str(METAFMU), *map(str, arguments)]
    result = subprocess.run(command, capture_output=True, text=True, cwd=cwd)
    assert not check or result.returncode == 0, result.stderr
    return result


def abort_at(moment, *arguments):
    """Runs the command, which has to end as if it were killed at a moment of crates/tables/src/fail_points.rs."""
    command, environment = [METAFMU, *map(str, arguments)], os.environ | {"METAFMU_ABORT_AT": moment}
    result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)
    assert result.returncode == -signal.SIGABRT, f"{moment!r} is never reached: {result.stderr}"


class RandomKills:
    """Kills commands at random moments.

    The first run of a command can be much slower than those after it. A command that ends before its
    moment therefore shortens the time from which later moments are drawn.
    """

    def __init__(self, seconds):
        self.seconds = seconds
        self.moments = random.Random(1)

    def __call__(self, *arguments, latest=1, after=None):
        """Run a command and kill it at a share of its time; true if it was still at work.

        The share is at most `latest`, and counts from when the file `after` exists.
        """
        begin = time.monotonic()
        process = subprocess.Popen([METAFMU, *map(str, arguments)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while after and not after.exists() and process.poll() is None:
            time.sleep(0.001)
        try:
            process.wait(self.moments.uniform(0, latest) * self.seconds)
        except subprocess.TimeoutExpired:
            process.kill()
            return process.wait() == -signal.SIGKILL
        self.seconds = min(self.seconds, time.monotonic() - begin)
        return False


def losses(folder):
    """The history but for wall times."""
    with open(folder / "history.csv") as file:
        return [{key: value for key, value in row.items() if key != "seconds"} for row in csv.DictReader(file)]


# of an example's study: all epochs are done, however good the network is
ALL_EPOCHS = [('schedule = "restarts"', 'schedule = "cosine"'), ("enough = 1e-7", "# enough = 1e-7")]


def changed(example, *changes):
    """The text of an example's study with some lines changed, each of which it must have."""
    text = (ROOT / "examples" / example).read_text()
    for line, other in changes:
        assert line in text, line
        text = text.replace(line, other)
    return text


def change(path, *changes):
    """The path of a file, in which patterns are replaced, each of which it must have."""
    text = path.read_text()
    for pattern, other in changes:
        assert re.search(pattern, text), (pattern, text)
        text = re.sub(pattern, other, text)
    path.write_text(text)
    return path


def small_study(epochs):
    """A study of the single pendulum named `study`, which builds in a second."""
    return changed(
        "single-pendulum.toml",
        ('name = "single-pendulum"', 'name = "study"'),
        ("runs = 1331", "runs = 40"),
        ("test_runs = 200", "test_runs = 5"),
        ("\nruns = 1000", "\nruns = 20"),
        ("step = 0.01", "step = 0.05"),
        ("hidden = [64, 64, 64, 64, 64, 64]", "hidden = [16, 16]"),
        ("batch = 1024", "batch = 128"),
        ("epochs = 150", f"epochs = {epochs}"),
        *ALL_EPOCHS,
    )


def pytest_configure(config):
    config.addinivalue_line("markers", "thorough: takes minutes, or its tool does to build; run by scripts/test.sh --ci and --all only")
    config.addinivalue_line("markers", "quick: also run by scripts/test.sh --quick")


def pytest_collection_modifyitems(items):
    """While one worker builds the pendulum, the others do what does not need it."""
    needs = {item.path for item in items if "pendulum" in item.fixturenames}
    builder = min(needs, default=None)
    items.sort(key=lambda item: (item.path != builder, item.path in needs))


def built_once(tmp_path_factory, name, build):
    """A copy of the folder `name`, which `build` fills for all workers."""
    shared = tmp_path_factory.getbasetemp()
    shared = shared.parent if IS_WORKER else shared
    with open(shared / f"{name}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (shared / name).exists():
            build(shared / f"unfinished-{name}")
            (shared / f"unfinished-{name}").rename(shared / name)
    return shutil.copytree(shared / name, tmp_path_factory.mktemp("copy") / name)


@pytest.fixture(scope="session")
def pendulum(tmp_path_factory):
    """The example as it stands, exported in both versions; tests write nothing else into its folder."""

    def build(folder):
        metafmu("build", "examples/single-pendulum.toml", "--out", folder)
        metafmu("export", "examples/single-pendulum.toml", "--out", folder, "--fmi", "both")

    folder = built_once(tmp_path_factory, "single-pendulum", build)
    metrics = json.loads((folder / "metrics.json").read_text())
    return Build(folder, folder / "single-pendulum.fmu", metrics)


def simulate_with_fmpy(build, length, damping, thetad0, version=2, **options):
    start_values = dict(zip(PARAMETERS, (length, damping, thetad0)))
    return simulate_fmu(build.fmus[version], start_values=start_values, output=OUTPUTS, **options)


def reference(length, damping, thetad0, times, mass=0.3, gravity=9.81):
    """theta, thetad, thetadd of the damped pendulum by scipy, independent of metafmu's integrator."""

    def derivative(_, state):
        theta, thetad = state
        return [thetad, -gravity / length * np.sin(theta) - damping / (mass * length) * thetad]

    solution = solve_ivp(
        derivative, (times[0], times[-1]), [np.pi / 2, thetad0], "DOP853", times, rtol=1e-12, atol=1e-12
    )
    theta, thetad = solution.y
    return np.stack([theta, thetad, derivative(0, solution.y)[1]])


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    options = webdriver.ChromeOptions()
    options.binary_location = "/usr/bin/chromium"
    for argument in ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-component-update",
                     "--disable-background-networking", "--disable-sync", f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"]:
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options, Service("/usr/bin/chromedriver"))
    yield driver
    driver.quit()


def show(browser, page, size):
    """Opens the page in a window of this size; returns what the page requested."""
    width, height = size
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": size != DESKTOP}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    # a new window has a separate page
    browser.get("about:blank")
    browser.get_log("performance")
    browser.get_log("browser")
    browser.get(page.as_uri())
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    return [message["params"]["request"]["url"] for message in messages if message["method"] == "Network.requestWillBeSent"]
