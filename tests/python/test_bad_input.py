"""Malformed input gets the message that docs/bad-input.md promises."""

import importlib.util

from conftest import ROOT

specification = importlib.util.spec_from_file_location("bad_input", ROOT / "scripts" / "bad-input.py")
bad_input = importlib.util.module_from_spec(specification)
specification.loader.exec_module(bad_input)


def test_every_message_is_the_documented_one():
    assert bad_input.document() == (ROOT / "docs" / "bad-input.md").read_text()


def test_there_are_many_cases_and_each_names_its_file():
    sections = bad_input.document().removeprefix(bad_input.INTRODUCTION)
    cases = [line for line in sections.splitlines() if line.startswith("| ") and "| what |" not in line]
    assert len(cases) >= 30
    endings = (".toml", ".csv", ".parquet", ".fmu", ".xlsx", ".onnx", ".pt", ".keras", ".pkl", ".mo", ".slx", ".ipynb", ".ssp")
    assert all(any(ending in case for ending in endings) for case in cases)
