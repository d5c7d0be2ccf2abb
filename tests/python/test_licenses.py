"""License texts that go with wheels, archives and FMUs."""

import json
import sys
import tomllib

from conftest import ROOT

sys.path.insert(0, str(ROOT / "scripts"))
import licenses  # noqa: E402
import sbom  # noqa: E402


def packages_of(programs, monkeypatch):
    """Names and versions of the third-party packages that are linked into programs on this platform."""
    # what was compiled here is here
    monkeypatch.setenv("CARGO_NET_OFFLINE", "true")
    packages, _ = sbom.linked(programs, ["x86_64-unknown-linux-gnu"])
    return {f"{package['name']} {package['version']}" for package in packages.values() if package["source"] is not None}


def test_every_package_in_wheels_and_fmus_has_a_license_text(monkeypatch):
    for programs, path in [(sbom.PROGRAMS, licenses.WHEEL / "THIRD-PARTY.txt"), (["fmu-template"], licenses.FMU)]:
        lines = path.read_text().splitlines()
        listed = {line.rpartition(" (")[0] for line in lines if line.endswith(")")}
        packages = packages_of(programs, monkeypatch)
        assert len(packages) > 10 and packages <= listed, f"run scripts/licenses.py: {path} lacks {sorted(packages - listed)}"
        assert "The Rust standard library, The Rust Project Developers" in listed


def test_bills_of_materials_in_wheels_have_no_paths_of_their_builder(monkeypatch):
    monkeypatch.setenv("CARGO_NET_OFFLINE", "true")
    bill = json.dumps(sbom.bill(*sbom.linked(sbom.PROGRAMS, ["x86_64-unknown-linux-gnu"])))
    assert "pkg:cargo/pyo3@" in bill and "path+file" not in bill and str(ROOT) not in bill
    # which takes the place of maturin's
    options = tomllib.loads((ROOT / "python" / "pyproject.toml").read_text())["tool"]["maturin"]
    assert options["sbom"] == {"rust": False}
    for script in ("wheel.sh", "release.sh"):
        assert "--sbom-include" in (ROOT / "scripts" / script).read_text(), script


def test_packages_that_were_removed_have_no_license_text():
    known = {f"{name} {version}" for name, version in sbom.checksums()}
    text = (licenses.WHEEL / "THIRD-PARTY.txt").read_text()
    before_standard_library = text[: text.index("The Rust standard library, ")]
    blocks = [block.split("\n\n")[0] for block in before_standard_library.split(licenses.RULE)]
    names = {line.rpartition(" (")[0] for block in blocks for line in block.splitlines()}
    # the standard library has further packages under the same texts
    versions = {name for name in names if not licenses.OF_STANDARD_LIBRARY.match(name.replace(" ", "-"))} - {""}
    assert len(versions) > 100 and versions <= known, f"run scripts/licenses.py: {sorted(versions - known)}"


def test_our_licenses_in_the_wheel_are_those_of_the_repository():
    for name in ("LICENSE-APACHE", "LICENSE-MIT"):
        assert (licenses.WHEEL / name).read_bytes() == (ROOT / name).read_bytes()
