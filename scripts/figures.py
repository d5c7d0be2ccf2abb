#!/usr/bin/env python3
"""Runs the commands behind the tables and figures of the documentation, and keeps what they print.

scripts/figures.toml lists them with their pages. Each figure has a text file, with the output of its commands, and a JSON file in a folder
named after date, commit and processor. A figure that fails does not stop the others. A second call continues: figures that were finished for the
same commit on the same kind of processor are not repeated. All take less than two hours on two idle cores; times of a busy machine mean little.

One command renews every figure, and docs/maintainers/measurements.md with date, commit and processor of each:

    scripts/venv.sh && scripts/venv.sh --peers && cargo build --release && .venv/bin/python scripts/figures.py --write

    .venv/bin/python scripts/figures.py --list               # names, pages, rough minutes
    .venv/bin/python scripts/figures.py                      # all, and the pages stay as they are
    .venv/bin/python scripts/figures.py stds plans           # some
    .venv/bin/python scripts/figures.py --minutes 2          # those that take two minutes or less
    .venv/bin/python scripts/figures.py --write motions      # also renews the rows of tables in the page that the output has, too

Needs target/release/metafmu and .venv (scripts/venv.sh); figures beside other programs need .peers (scripts/venv.sh --peers). The exit code is 1 if
a figure failed.
"""

import argparse
import datetime
import json
import os
import platform
import re
import signal
import subprocess
import sys
import textwrap
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIST = ROOT / "scripts" / "figures.toml"
MEASUREMENTS = ROOT / "docs" / "maintainers" / "measurements.md"
# of paragraphs that are renewed
WIDTH = 140
PEERS = ROOT / ".peers" / "bin" / "python"


def figures(file=LIST):
    """Entries of the list by name."""
    return tomllib.loads(file.read_text(encoding="utf-8"))


def processor():
    """Name of the processor, as the system has it."""
    if Path("/proc/cpuinfo").exists():
        match = re.search(r"^model name\s*: (.*)$", Path("/proc/cpuinfo").read_text(), re.M)
        if match:
            return match[1]
    return platform.processor() or platform.machine()


def commit():
    """Short hash of the commit, with `-changed` if tracked files other than pages differ from it: `--write` changes these."""
    git = lambda *arguments: subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    return git("rev-parse", "--short=9", "HEAD") + ("-changed" if git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!docs", ":!*.md") else "")


def folder_of(parent):
    """Folder of this commit and processor: the newest that exists, else a new one with today's date."""
    end = f"{commit()}-{re.sub(r'[^a-z0-9]+', '-', processor().lower()).strip('-')}"
    there = sorted(parent.glob(f"[0-9]*-{end}"))
    return there[-1] if there else parent / f"{datetime.date.today()}-{end}"


def load():
    """Mean number of running processes in the last minute, None where the system does not count."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def run(name, figure, folder):
    """Runs the commands of a figure until one fails, and returns its record."""
    programs = [ROOT / "target" / "release", ROOT / ".venv" / "bin"]
    out, work = folder / name, folder / "work"
    out.mkdir(parents=True, exist_ok=True)
    work.mkdir(exist_ok=True)
    own = {"ROOT": ROOT, "OUT": out, "WORK": work, "PEERS": PEERS, "PATH": os.pathsep.join([*map(str, programs), os.environ["PATH"]]), "MPLBACKEND": "agg"}
    environment = {**os.environ, **{key: str(value) for key, value in own.items()}}
    begin, record = time.monotonic(), {"page": figure["page"], "commands": figure["commands"], "started": f"{datetime.datetime.now():%Y-%m-%d %H:%M}", "load": load()}
    with open(folder / f"{name}.txt", "w", encoding="utf-8") as output:
        for command in figure["commands"]:
            print(f"$ {command}", file=output, flush=True)
            # a separate session, so that Ctrl-C ends everything it started
            process = subprocess.Popen(
                ["bash", "-euo", "pipefail", "-c", command], cwd=ROOT, env=environment, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
            )
            try:
                code = process.wait()
            except KeyboardInterrupt:
                os.killpg(process.pid, signal.SIGTERM)
                process.wait()
                raise
            if code:
                break
    return {**record, "exit_code": code, "seconds": round(time.monotonic() - begin, 1)}


def replace(path, text):
    """Writes a file completely or not at all."""
    unfinished = path.with_suffix(".unfinished")
    unfinished.write_text(text, encoding="utf-8", newline="\n")
    unfinished.replace(path)


def cells(row):
    """Cells of a table's row, without code marks."""
    return [cell.strip().replace("`", "") for cell in row.strip().strip("|").split("|")]


def tables(text):
    """Each table: cells of its heading, and line numbers of its rows, between which a program may print other lines."""
    lines, found = text.split("\n"), []
    is_rule = [bool(re.fullmatch(r"\|[|\s:-]+", line)) for line in [*lines, ""]]
    for number, line in enumerate(lines):
        if is_rule[number]:
            found.append((cells(lines[number - 1]), []))
        elif line.startswith("|") and found and not is_rule[number + 1]:
            found[-1][1].append(number)
    return found


def renewed(page, output, key):
    """The page with rows of the output, and their number: those of tables with the same heading and the same first `key` cells."""
    new, lines, count = output.split("\n"), page.split("\n"), 0
    for heading, places in tables(page):
        rows = {tuple(cells(new[row])[:key]): new[row] for other, of in tables(output) if other == heading for row in of}
        for place in places:
            if row := rows.get(tuple(cells(lines[place])[:key])):
                lines[place], count = row, count + 1
    return "\n".join(lines), count


def with_blocks(page, output, blocks):
    """The page with lines of the output, and their number: those after a heading that both have, up to an empty line."""
    new, count = output.split("\n"), 0
    for heading in blocks:
        is_heading = lambda line: " ".join(line.split()).startswith(heading)
        lines = page.split("\n")
        begin = next((number for number, line in enumerate(lines) if line.startswith("    ") and is_heading(line)), None)
        first = next((number for number, line in enumerate(new) if is_heading(line)), None)
        if begin is None or first is None:
            raise ValueError(f"`{heading}` begins no block of {'the page' if begin is None else 'the output'}")
        end_of = lambda lines, number: next((later for later in range(number, len(lines)) if not lines[later].strip()), len(lines))
        found = [f"    {line}".rstrip() for line in new[first : end_of(new, first)]]
        page = "\n".join([*lines[:begin], *found, *lines[end_of(lines, begin) :]])
        count += len(found)
    return page, count


def with_paragraphs(page, output, beginnings):
    """The page with paragraphs and list items of the output, and their number. The output has each in one line, with the same beginning."""
    lines, printed, count = page.split("\n"), output.split("\n"), 0
    for beginning in beginnings:
        begin = next((number for number, line in enumerate(lines) if line.startswith(beginning)), None)
        text = next((line for line in printed if line.startswith(beginning)), None)
        if begin is None or text is None:
            raise ValueError(f"`{beginning}` begins no paragraph of {'the page' if begin is None else 'the output'}")
        end = next((number for number in range(begin + 1, len(lines)) if not lines[number].strip() or lines[number].startswith("- ")), len(lines))
        hanging = "  " if text.startswith("- ") else ""
        wrapped = textwrap.wrap(text, WIDTH, subsequent_indent=hanging, break_long_words=False, break_on_hyphens=False)
        lines[begin:end] = wrapped
        count += len(wrapped)
    return "\n".join(lines), count


def write(name, figure, folder):
    """Renews the rows, blocks and paragraphs of the page of a figure, if the entry tells which they are."""
    if not figure.keys() & {"key", "blocks", "paragraphs"}:
        return "not written: the entry has neither `key`, `blocks` nor `paragraphs`"
    page = ROOT / figure["page"].split("#")[0]
    text, output, count = page.read_text(encoding="utf-8"), (folder / f"{name}.txt").read_text(encoding="utf-8"), 0
    if "key" in figure:
        text, count = renewed(text, output, figure["key"])
    try:
        text, lines = with_blocks(text, output, figure.get("blocks", []))
        text, sentences = with_paragraphs(text, output, figure.get("paragraphs", []))
    except ValueError as error:
        return f"not written: {error}"
    replace(page, text)
    return f"{count + lines + sentences} rows of {figure['page'].split('#')[0]} written"


def link(page):
    """A link to a page from the list of measurements; the name alone of one that the site does not have."""
    file, _, heading = page.partition("#")
    return f"[{file}](../{page.removeprefix('docs/')})" if file.startswith("docs/") else file


def listed_measurements(text, listed, folder):
    """The page of measurements, with the records of a folder; rows of other figures stay, those of unknown figures go."""
    about = json.loads((folder / "machine.json").read_text(encoding="utf-8"))
    heading = ["figure", "page", "date", "commit", "processor", "cores", "load before", "min"]
    lines, rows = text.split("\n"), {}
    [places] = [places for found, places in tables(text) if found == heading]
    for place in places:
        rows[cells(lines[place])[0]] = lines[place]
    for name, figure in listed.items():
        record = folder / f"{name}.json"
        found = json.loads(record.read_text(encoding="utf-8")) if record.exists() else {"exit_code": 1}
        if found["exit_code"] == 0:
            of = [name, link(figure["page"]), found["started"].split(" ")[0], about["commit"], about["processor"], about["processors"], found["load"]]
            rows[name] = f"| {' | '.join(map(str, of))} | {found['seconds'] / 60:.1f} |"
    begin, end = (places[0], places[-1] + 1) if places else (rule_of(lines, heading) + 1,) * 2
    lines[begin:end] = [rows[name] for name in listed if name in rows]
    return "\n".join(lines)


def rule_of(lines, heading):
    """Number of the line between a heading and its rows."""
    return 1 + next(number for number, line in enumerate(lines) if line.startswith("|") and cells(line) == heading)


def is_done(folder, name, figure):
    """Returns True if the same commands were successful before."""
    record = folder / f"{name}.json"
    if not record.exists():
        return False
    found = json.loads(record.read_text(encoding="utf-8"))
    return found["exit_code"] == 0 and found["commands"] == figure["commands"]


def has_peers():
    """Returns True if .peers has the packages of its list."""
    installed, listed = ROOT / ".peers" / "requirements.txt", ROOT / "scripts" / "measure" / "requirements.txt"
    return installed.exists() and installed.read_text(encoding="utf-8") == listed.read_text(encoding="utf-8")


def chosen(listed, names, minutes):
    """The figures to run: all, those that are named, or those that take at most some minutes. Ends the program for an unknown name."""
    if unknown := [name for name in names if name not in listed]:
        sys.exit(f"error: unknown figure {', '.join(f'`{name}`' for name in unknown)}, expected some of {', '.join(listed)}")
    return {name: figure for name, figure in listed.items() if name in (names or listed) and (minutes is None or figure["minutes"] <= minutes)}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="figures of the list; all unless given")
    parser.add_argument("--list", action="store_true", help="print names, pages and commands, and run nothing")
    parser.add_argument("--minutes", type=float, metavar="N", help="only those that take about N minutes or less")
    parser.add_argument("--again", action="store_true", help="also those that were finished before")
    parser.add_argument("--write", action="store_true", help="renew tables, blocks and paragraphs of the pages, and the page of measurements")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "figures", help="where the folder of results is made; out/figures unless given")
    parser.add_argument("--from", dest="file", type=Path, default=LIST, metavar="FILE", help="another list")
    options = parser.parse_args()
    wanted = chosen(figures(options.file), options.names, options.minutes)
    if options.list:
        width = max(map(len, wanted), default=0)
        for name, figure in wanted.items():
            needs = f"; needs {', '.join(figure['needs'])}" if "needs" in figure else ""
            print(f"{name:{width}}  {figure['page']}, about {figure['minutes']} min{needs}")
            print("".join(f"{'':{width}}    {line}\n" for command in figure["commands"] for line in command.splitlines()), end="")
        return 0
    if not has_peers() and any("$PEERS" in command for figure in wanted.values() for command in figure["commands"]):
        sys.exit("error: .peers, the environment of the other programs, is missing or out of date: scripts/venv.sh --peers")
    program = ROOT / "target" / "release" / "metafmu"
    if not program.exists():
        sys.exit(f"error: {program} is missing: cargo build --release")
    folder = folder_of(options.out.resolve())
    folder.mkdir(parents=True, exist_ok=True)
    version = subprocess.run([program, "--version", "--verbose"], capture_output=True, text=True).stdout.strip()
    about = {"commit": commit(), "processor": processor(), "processors": os.cpu_count(), "system": platform.platform(), "python": platform.python_version(), "metafmu": version}
    replace(folder / "machine.json", json.dumps(about, indent=2) + "\n")
    print(folder)
    failed = []
    for name, figure in wanted.items():
        missing = [f"{variable} is not set: {what}" for variable, what in figure.get("needs", {}).items() if not os.environ.get(variable)]
        if missing:
            print(f"{name}: skipped, {'; '.join(missing)}", flush=True)
        elif not options.again and is_done(folder, name, figure):
            print(f"{name}: finished before", flush=True)
            if options.write:
                print(f"{name}: {write(name, figure, folder)}")
        else:
            print(f"{name}: about {figure['minutes']} min", end="", flush=True)
            record = run(name, figure, folder)
            replace(folder / f"{name}.json", json.dumps(record, indent=2) + "\n")
            failed += [name] if record["exit_code"] else []
            how = f"FAILED with exit code {record['exit_code']}" if record["exit_code"] else "finished"
            print(f"; {how} after {record['seconds']:.0f} s: {name}.txt", flush=True)
            if options.write and not record["exit_code"]:
                print(f"{name}: {write(name, figure, folder)}")
    if options.write and options.file == LIST:
        replace(MEASUREMENTS, listed_measurements(MEASUREMENTS.read_text(encoding="utf-8"), figures(), folder))
        print(f"{MEASUREMENTS.relative_to(ROOT)} written")
    if failed:
        print(f"{len(failed)} of {len(wanted)} failed: {', '.join(failed)}")
    return 1 if failed else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        # what was finished stays
        sys.exit(130)
