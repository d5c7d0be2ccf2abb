"""Writes the license texts that go with wheels, archives and FMUs: of every package that is compiled into them, and of Rust's standard library.

- python/licenses/: our own licenses, and THIRD-PARTY.txt with the packages of the command and the Python extension
- crates/export/src/export/assets/third-party.txt: the packages of the FMU's library, which `metafmu` puts into every FMU

The files are in the repository, as `maturin build` and `cargo build` take them from there. tests/python/test_licenses.py notices when they lack a package.

Usage: python3 scripts/licenses.py, after a change of Cargo.lock
"""

import argparse
import html
import re
import shutil
import subprocess
from pathlib import Path

import sbom

ROOT = Path(__file__).resolve().parent.parent
WHEEL = ROOT / "python" / "licenses"
FMU = ROOT / "crates" / "export" / "src" / "export" / "assets" / "third-party.txt"
LICENSE_FILE = re.compile(r"(?i)(licen[cs]e|copying|notice|unlicense)")
# packages of Rust's standard library on the platforms of releases; the others are for other systems, or for its build
OF_STANDARD_LIBRARY = re.compile(r"(cfg-if|foldhash|gimli|hashbrown|libc|rustc-demangle|unwinding|windows)[-_]")
RULE = "\n\n" + "=" * 100 + "\n\n"


class Texts:
    """License texts, each once, with the packages that have it."""

    def __init__(self):
        self.names = {}

    def add(self, text, name):
        # versions of a text that differ in line breaks are one
        key = " ".join(text.split())
        names = self.names.setdefault(key, (text.strip(), []))[1]
        if name not in names:
            names.append(name)

    def joined(self):
        return RULE.join("\n".join(names) + "\n\n" + text for text, names in self.names.values()) + "\n"


def needed(files, expression, name_of):
    """The files of the license to take: MIT, if it is an alternative, as its text is short."""
    parts = re.split(r"\s+OR\s+|\s*/\s*", expression or "")
    mit = [file for file in files if "mit" in name_of(file).lower()]
    return mit if len(parts) > 1 and "MIT" in parts and mit else files


def add_packages(texts, packages):
    """Adds the packages of others."""
    for package in sorted(packages.values(), key=lambda package: (package["name"], package["version"])):
        if package["source"] is None:
            continue
        folder = Path(package["manifest_path"]).parent
        files = sorted(path for path in folder.iterdir() if LICENSE_FILE.match(path.name) and path.is_file())
        name = f"{package['name']} {package['version']} ({package['license']})"
        for file in needed(files, package["license"], lambda file: file.name):
            texts.add(file.read_text(errors="replace"), name)
        if not files:
            texts.add("No license file: the terms are those that the package names.", name)


def add_standard_library(texts):
    """Adds what the toolchain's documentation has."""
    folder = Path(subprocess.run(["rustc", "--print", "sysroot"], check=True, capture_output=True, text=True).stdout.strip()) / "share/doc/rust"
    for license, what in [("MIT", "MIT OR Apache-2.0"), ("Unicode-3.0", "Unicode-3.0, its tables of characters")]:
        texts.add((folder / "licenses" / f"{license}.txt").read_text(), f"The Rust standard library, The Rust Project Developers ({what})")
    page = (folder / "COPYRIGHT-library.html").read_text()
    for part in page.split("<h3>")[1:]:
        package = re.match(r"\W*([\w.+-]+)</h3>", part)[1]
        if not OF_STANDARD_LIBRARY.match(package):
            continue
        expression = re.search(r"<b>License:</b> ([^<]*)</p>", part)[1].strip()
        found = re.findall(r"<summary><code>([^<]*)</code></summary>\s*<pre>\n(.*?)</pre>", part, re.DOTALL)
        for _, text in needed(found, expression, lambda file: file[0]):
            texts.add(html.unescape(text).rstrip(), f"{package.rpartition('-')[0]} {package.rpartition('-')[2]} ({expression})")


def third_party(programs):
    """License texts of all that is compiled into programs."""
    packages, _ = sbom.linked(programs)
    texts = Texts()
    add_packages(texts, packages)
    add_standard_library(texts)
    return texts.joined()


def main():
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    WHEEL.mkdir(exist_ok=True)
    for name in ("LICENSE-APACHE", "LICENSE-MIT"):
        shutil.copyfile(ROOT / name, WHEEL / name)
    (WHEEL / "THIRD-PARTY.txt").write_text(third_party(sbom.PROGRAMS))
    FMU.write_text(third_party(["fmu-template"]))


if __name__ == "__main__":
    main()
