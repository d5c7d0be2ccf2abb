"""Files: existing ones at the path of an output, changed ones, and full disks."""

import os
import random
import re
import resource
import shutil
import signal
import socket
import stat
import subprocess
import threading
import time
from pathlib import Path

import pytest
from conftest import ALL_EPOCHS, ANY, METAFMU, abort_at, changed, metafmu

TABLES = ("train", "test", "calibration")
ROOT = Path(__file__).parents[2]


def test_no_two_examples_of_the_documentation_write_the_same_study():
    examples = {}
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        for name, arguments in re.findall(r"metafmu new (my-\S+) ([^#`\n]+)", page.read_text()):
            examples.setdefault(name, set()).add(" ".join(arguments.split()))
    assert len(examples) > 8
    assert {name: found for name, found in examples.items() if len(found) > 1} == {}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A study and its folder of results."""
    text = changed(
        "single-pendulum.toml",
        ('name = "single-pendulum"', 'name = "study"'),
        ("runs = 1331", "runs = 40"),
        ("test_runs = 200", "test_runs = 5"),
        ("\nruns = 1000", "\nruns = 40"),
        ("step = 0.01", "step = 0.05"),
        ("hidden = [64, 64, 64, 64, 64, 64]", "hidden = [64, 64]"),
        ("batch = 1024", "batch = 128"),
        ("epochs = 150", "epochs = 5"),
        *ALL_EPOCHS,
    )
    study = tmp_path_factory.mktemp("files") / "study.toml"
    study.write_text(text + ANY)
    metafmu("build", study, "--out", study.parent / "out")
    return study, study.parent / "out"


@pytest.fixture
def copied(built, tmp_path):
    """A copy of `built`, to be changed."""
    return built[0], shutil.copytree(built[1], tmp_path / "out")


@pytest.fixture(scope="module")
def table(built):
    """Table that `simulate` prints."""
    return metafmu("simulate", built[1] / "study.fmu").stdout


def simulate(built, output, **options):
    command = [METAFMU, "simulate", built[1] / "study.fmu", "--output", output]
    return subprocess.run(command, capture_output=True, text=True, **options)


def test_what_is_no_file_is_written_to_and_stays(built, table, tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    found = []
    reader = threading.Thread(target=lambda: found.append(pipe.read_text()))
    reader.start()
    assert simulate(built, pipe).returncode == 0
    reader.join()
    assert found == [table] and stat.S_ISFIFO(pipe.stat().st_mode)

    # a terminal
    terminal, slave = os.openpty()
    name = os.ttyname(slave)
    assert simulate(built, name, env={**os.environ, "TERM": "dumb"}).returncode == 0
    assert os.read(terminal, 100).startswith(b"time,theta") and stat.S_ISCHR(os.stat(name).st_mode)

    device = tmp_path / "device"
    device.symlink_to("/dev/null")
    assert simulate(built, device).returncode == 0 and device.is_symlink()
    device.unlink()
    device.symlink_to("/dev/full")
    refused = simulate(built, device)
    assert refused.returncode == 2
    assert f"{device}: cannot write: No space left on device" in refused.stderr


def test_a_socket_is_written_to_and_stays(built, table, tmp_path):
    path = tmp_path / "socket"
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        server.listen()
        assert simulate(built, path).returncode == 0
        with server.accept()[0].makefile() as file:
            assert file.read() == table


def test_dev_stdout_is_the_standard_output(built, table, tmp_path):
    for name in ("/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"):
        assert simulate(built, name).stdout == table
        log = tmp_path / "log"
        log.write_text("before\n")
        with open(log, "a") as file:
            command = [METAFMU, "simulate", built[1] / "study.fmu", "--output", name]
            assert subprocess.run(command, stdout=file).returncode == 0
        assert log.read_text() == "before\n" + table, "what is there is kept"
    command = f"{METAFMU} simulate {built[1] / 'study.fmu'} --output >(cat) | cat"
    assert subprocess.run(["bash", "-c", command], capture_output=True, text=True).stdout == table


def test_links_lead_to_the_file_and_its_mode_stays(built, table, tmp_path):
    file, link, name = tmp_path / "file", tmp_path / "link", tmp_path / "name"
    file.write_text("old")
    file.chmod(0o640)
    link.symlink_to("file")
    name.hardlink_to(file)
    for path in (link, name, file):
        file.write_text("old")
        assert simulate(built, path).returncode == 0
        assert link.is_symlink() and file.read_text() == name.read_text() == table
        assert stat.S_IMODE(file.stat().st_mode) == 0o640
    name.unlink()
    assert simulate(built, file).returncode == 0
    assert file.read_text() == table and stat.S_IMODE(file.stat().st_mode) == 0o640
    (tmp_path / "dangling").symlink_to("new")
    plot = metafmu("simulate", built[1] / "study.fmu", "--plot", tmp_path / "dangling")
    assert plot.returncode == 0 and "<svg" in (tmp_path / "new").read_text()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dangling", "file", "link", "new"]


def test_the_owner_of_a_file_stays(built, tmp_path):
    if os.geteuid() != 0:
        pytest.skip("only root writes to the files of others")
    file = tmp_path / "file"
    file.write_text("old")
    os.chown(file, 1234, 2345)
    assert simulate(built, file).returncode == 0
    assert (file.stat().st_uid, file.stat().st_gid) == (1234, 2345) and file.stat().st_size > 3


def test_a_folder_is_refused_before_the_simulation(built, tmp_path):
    for path, says in [(tmp_path, "is a directory"), (tmp_path / "no" / "run.svg", f"no folder {tmp_path / 'no'}")]:
        for option in ("--output", "--plot"):
            refused = metafmu("simulate", built[1] / "absent.fmu", option, path, check=False)
            assert refused.returncode == 2 and f"{path}: cannot write" in refused.stderr and says in refused.stderr


def corrupt(path, number):
    """Changes a digit behind the header."""
    content = bytearray(path.read_bytes())
    digits = [place for place in range(content.index(b"\n"), len(content)) if 48 <= content[place] <= 57]
    place = digits[number % len(digits)]
    content[place] ^= 1
    path.write_bytes(content)


def test_a_table_that_was_changed_is_used_by_no_verb(copied):
    study, folder = copied
    before = {path: path.read_bytes() for path in folder.iterdir()}
    numbers = random.Random(1)
    for verb, tables in [
        ("train", ("train", "calibration")),
        ("build", TABLES),
        ("evaluate", ("test",)),
        ("report", ("test",)),
        ("export", ("test",)),
        ("compare", ("train", "test")),
    ]:
        for table in tables:
            path = folder / f"{table}.csv"
            corrupt(path, numbers.randrange(10**6))
            wrong = path.read_bytes()
            resume = ["--resume"] if verb == "build" else []
            refused = metafmu(verb, study, "--out", folder, *resume, check=False)
            assert refused.returncode == 2, (verb, table, refused.stderr)
            assert f"{path}: was changed or damaged after the sampling" in refused.stderr
            assert "run `metafmu sample` again" in refused.stderr and "source.table" in refused.stderr
            assert path.read_bytes() == wrong
            path.write_bytes(before[path])
            assert {path: path.read_bytes() for path in folder.iterdir()} == before
    # it is as it was
    metafmu("evaluate", study, "--out", folder)


def test_no_corruption_of_a_checkpoint_resumes_to_another_network(copied):
    study, folder = copied
    checkpoint = folder / "checkpoint.safetensors"
    abort_at("replaced checkpoint.safetensors", "train", study, "--out", folder)
    good = checkpoint.read_bytes()
    places = random.Random(2)
    for _ in range(24):
        place = places.randrange(len(good))
        wrong = bytearray(good)
        wrong[place] ^= 1 << places.randrange(8)
        checkpoint.write_bytes(wrong)
        refused = metafmu("train", study, "--out", folder, "--resume", check=False)
        assert refused.returncode == 2 and "without --resume" in refused.stderr, (place, refused.stderr)
        assert checkpoint.read_bytes() == wrong


def test_what_a_killed_process_has_not_finished_is_removed(copied):
    study, folder = copied
    (folder / ".metafmu-a1B2c3").write_text("half a checkpo")
    metafmu("evaluate", study, "--out", folder)
    assert not [path for path in folder.iterdir() if path.name.startswith(".metafmu-")]


def test_the_journal_of_a_sampling_that_was_killed_at_its_very_end_is_removed(copied):
    study, folder = copied
    (folder / "unfinished-runs.bin").write_bytes(b"runs that the tables have")
    metafmu("build", study, "--out", folder, "--resume")
    assert not (folder / "unfinished-runs.bin").exists()


def without_room():
    """For a new process: files of 2 kB at most, whose excess is an error as that of a full disk."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, resource.RLIM_INFINITY))


def train_without_room(study, folder):
    """A training that has ended and waits for room."""
    command = [METAFMU, "train", study, "--out", folder]
    options = {"stderr": subprocess.PIPE, "text": True, "preexec_fn": without_room, "restore_signals": False}
    process = subprocess.Popen(command, **options)
    said = ""
    while "waiting for room" not in said:
        line = process.stderr.readline()
        assert line, said
        said += line
    assert f"{folder / 'study.safetensors'}: cannot write: File too large (os error 27): the file needs" in said
    return process


def test_a_trained_network_waits_for_room(copied):
    study, folder = copied
    expected = (folder / "study.safetensors").read_bytes()
    (folder / "study.safetensors").unlink()
    process = train_without_room(study, folder)
    assert not (folder / "study.safetensors").exists()
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    assert process.wait(60) == 0
    assert (folder / "study.safetensors").read_bytes() == expected
    metafmu("evaluate", study, "--out", folder)


def test_ctrl_c_ends_the_wait_for_room(copied):
    process = train_without_room(*copied)
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 2
    assert "the trained network is lost" in process.stderr.read()


def test_a_trained_network_is_saved_elsewhere_if_its_folder_is_gone(copied, tmp_path):
    _, folder = copied
    study = tmp_path / "study.toml"
    study.write_text(copied[0].read_text().replace("epochs = 5", "epochs = 200"))
    (tmp_path / "temporary").mkdir()
    environment = {**os.environ, "TMPDIR": str(tmp_path / "temporary")}
    command = [METAFMU, "train", study, "--out", folder]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
    while not (folder / "checkpoint.safetensors").exists():
        assert process.poll() is None
        time.sleep(0.01)
    moved = folder.rename(tmp_path / "moved")
    folder.write_text("no folder")
    said = process.communicate()[1]
    assert process.returncode == 2
    [saved] = (tmp_path / "temporary").iterdir()
    assert f"the results are in {saved}: move them to {folder}" in said
    assert sorted(path.name for path in saved.iterdir()) == ["history.csv", "study.safetensors", "training.json"]
    for path in saved.iterdir():
        path.rename(moved / path.name)
    metafmu("evaluate", study, "--out", moved)


def test_a_table_that_is_a_pipe_is_refused(tmp_path):
    os.mkfifo(tmp_path / "runs.csv")
    (tmp_path / "study.toml").write_text(
        'name = "s"\n[source]\ntable = "runs.csv"\n[time]\nstop = 1\nstep = 0.5\n[parameters]\nL = { min = 0.1, max = 0.2 }\n[outputs]\ny = {}\n'
    )
    command = [METAFMU, "sample", tmp_path / "study.toml", "--dry-run"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=20)
    assert result.returncode == 2 and "runs.csv: cannot read: it is not a regular file" in result.stderr, result.stderr
