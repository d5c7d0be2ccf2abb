"""Prints the bill of materials of the released programs: every Rust package that is compiled into them, as CycloneDX 1.6.

That is what `cargo metadata` has for the command and the Python extension, on the platforms of releases, without what only builds and
tests need. The checksums are those of Cargo.lock.

Usage: python3 scripts/sbom.py [--target TARGET] > metafmu.cdx.json

With --target, only packages of one platform: a wheel has this bill instead of that of maturin, which has paths of the builder's machine.
"""

import argparse
import hashlib
import json
import re
import subprocess
import tomllib
import uuid
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TARGETS = ["x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu", "x86_64-pc-windows-gnu"]
PROGRAMS = ["metafmu", "metafmu-python", "fmu-template"]


def metadata(target):
    command = ["cargo", "metadata", "--format-version", "1", "--locked", "--filter-platform", target]
    return json.loads(subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout)


def linked(programs, targets=TARGETS):
    """Packages of programs by id, and the ids of those that each is linked with."""
    packages, edges = {}, {}
    for target in targets:
        found = metadata(target)
        by_id = {package["id"]: package for package in found["packages"]}
        nodes = {node["id"]: node for node in found["resolve"]["nodes"]}
        waiting = [id for id, package in by_id.items() if package["name"] in programs and package["source"] is None]
        seen = set(waiting)
        while waiting:
            id = waiting.pop()
            packages[id] = by_id[id]
            # what runs in the compiler and what only tests need is in no program
            normal = {
                dependency["pkg"]
                for dependency in nodes[id]["deps"]
                if any(kind["kind"] is None for kind in dependency["dep_kinds"]) and not only_in_compiler(by_id[dependency["pkg"]])
            }
            edges.setdefault(id, set()).update(normal)
            waiting += normal - seen
            seen |= normal
    return packages, edges


def only_in_compiler(package):
    return any("proc-macro" in target["kind"] for target in package["targets"])


def checksums():
    lock = tomllib.loads((ROOT / "Cargo.lock").read_text())
    return {(package["name"], package["version"]): package.get("checksum") for package in lock["package"]}


def purl(package):
    return f"pkg:cargo/{package['name']}@{package['version']}"


def component(package, checksum, kind="library"):
    result = {"type": kind, "bom-ref": purl(package), "name": package["name"], "version": package["version"]}
    if package["description"]:
        result["description"] = " ".join(package["description"].split())
    if checksum:
        result["hashes"] = [{"alg": "SHA-256", "content": checksum}]
    if package["license"]:
        # older packages separate alternatives by a slash, which SPDX does not know
        result["licenses"] = [{"expression": re.sub(r"\s*/\s*", " OR ", package["license"])}]
    result["purl"] = purl(package)
    if package["repository"]:
        result["externalReferences"] = [{"type": "vcs", "url": package["repository"]}]
    return result


def bill(packages, edges):
    known = checksums()
    ordered = sorted(packages.values(), key=lambda package: (package["name"], package["version"]))
    program = next(package for package in ordered if package["name"] == "metafmu")
    components = [component(p, known[p["name"], p["version"]]) for p in ordered if p is not program]
    dependencies = [
        {"ref": purl(package), "dependsOn": sorted(purl(packages[id]) for id in edges[package["id"]])} for package in ordered
    ]
    content = json.dumps([components, dependencies])
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        # of the content: the same release has the same one
        "serialNumber": f"urn:uuid:{uuid.UUID(bytes=hashlib.sha256(content.encode()).digest()[:16], version=4)}",
        "version": 1,
        "metadata": {"component": component(program, None, "application")},
        "components": components,
        "dependencies": dependencies,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--target", help="platform as rustc names it, by default all platforms of releases")
    options = parser.parse_args()
    print(json.dumps(bill(*linked(PROGRAMS, [options.target] if options.target else TARGETS)), indent=2, ensure_ascii=False))


if __name__ == "__main__":
    main()
