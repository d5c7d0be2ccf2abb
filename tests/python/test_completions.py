"""Completion in shells, by the shells themselves, and the man pages."""

import re
import shutil
import subprocess

import pytest
from conftest import METAFMU

VERBS = {
    "new", "build", "sample", "train", "search", "evaluate", "compare", "report", "export", "import", "schema", "validate", "simulate",
    "plan", "predict", "swap", "completions", "help",
}  # fmt: skip
# what Bash does when somebody presses Tab after the words
COMPLETE = """
source "$1"; shift
# how the offers are shown, which only Bash itself may ask for
compopt() { :; }
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMP_LINE="$*"; COMP_POINT=${#COMP_LINE}
read -r _ _ function _ <<<"$(complete -p metafmu | sed 's/.*-F/complete -F/')"
"$function" metafmu "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}"
printf '%s\\n' "${COMPREPLY[@]}"
"""


def script(shell, folder):
    path = folder / f"metafmu.{shell}"
    path.write_bytes(subprocess.run([METAFMU, "completions", shell], check=True, stdout=subprocess.PIPE).stdout)
    return path


@pytest.fixture(scope="module")
def bash(tmp_path_factory):
    """Completions by Bash for the last of some words."""
    folder = tmp_path_factory.mktemp("completions")
    path = script("bash", folder)
    (folder / "study.toml").write_text("")
    (folder / "results").mkdir()

    def complete(*words):
        command = ["bash", "--norc", "--noprofile", "-euc", COMPLETE, "bash", path, "metafmu", *words]
        done = subprocess.run(command, cwd=folder, check=True, text=True, stdout=subprocess.PIPE)
        return set(done.stdout.split())

    return complete


def test_bash_offers_every_verb_and_no_hidden_one(bash):
    offered = bash("")
    assert VERBS <= offered
    assert not {"man", "fit-baseline"} & offered
    assert bash("sim") == {"simulate"}


def test_bash_offers_the_options_of_a_verb(bash):
    assert bash("export", "--fm") == {"--fmi"}
    assert {"--system", "--mechanism", "--fmu", "--table", "--structure"} <= bash("new", "--")
    assert "--structure" not in bash("build", "--")


def test_bash_offers_the_values_of_an_option(bash):
    assert bash("export", "study.toml", "--fmi", "") == {"2", "3", "both"}
    assert bash("new", "x", "--structure", "d") == {"dynamics", "discrete"}
    assert bash("completions", "") >= {"bash", "zsh", "fish"}


def test_bash_offers_files(bash):
    assert bash("build", "study.toml", "--out", "re") == {"results"}
    assert bash("simulate", "x.fmu", "--input", "st") == {"study.toml"}
    assert bash("predict", "x.fmu", "t.csv", "--out", "st") == {"study.toml"}


@pytest.mark.parametrize("shell, check", [("bash", ["bash", "-n"]), ("zsh", ["zsh", "-n"]), ("fish", ["fish", "--no-execute"])])
def test_the_shell_reads_its_script(shell, check, tmp_path):
    assert shutil.which(shell), f"{shell} is missing: scripts/shells.sh installs it"
    path = script(shell, tmp_path)
    done = subprocess.run([*check, path], text=True, capture_output=True)
    assert done.returncode == 0 and done.stderr == ""


def test_fish_offers_verbs_and_values(tmp_path):
    assert shutil.which("fish"), "fish is missing: scripts/shells.sh installs it"
    path = script("fish", tmp_path)

    def complete(line):
        command = ["fish", "--no-config", "--command", f"source {path}; complete --do-complete '{line}'"]
        done = subprocess.run(command, check=True, text=True, stdout=subprocess.PIPE)
        return {offer.split("\t")[0] for offer in done.stdout.splitlines()}

    assert complete("metafmu sim") == {"simulate"}
    assert complete("metafmu new x --structure d") == {"dynamics", "discrete"}


def test_a_page_for_the_command_and_each_verb(tmp_path):
    subprocess.run([METAFMU, "man", tmp_path / "man1"], check=True)
    pages = {path.name: path.read_text() for path in (tmp_path / "man1").iterdir()}
    assert set(pages) == {"metafmu.1"} | {f"metafmu-{verb}.1" for verb in VERBS - {"help"}}
    for verb in VERBS - {"help"}:
        shown = subprocess.run([METAFMU, verb, "--help"], check=True, text=True, stdout=subprocess.PIPE).stdout
        page = pages[f"metafmu-{verb}.1"].replace("\\-", "-")
        assert ".SH SYNOPSIS" in page
        for option in re.findall(r"^ +(?:-\w, )?(--[a-z-]+)", shown, re.MULTILINE):
            assert option in page, f"{verb} {option}"
