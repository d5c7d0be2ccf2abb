#!/usr/bin/env python3
"""Checks the English of documentation, doc comments, docstrings, comments of C and texts of Rust against docs/maintainers/style.md.

Refused are the phrases of the page's table, sentences of more than 35 words, and summaries of doc comments and comments of C
that open with a pronoun or a clause: OPENINGS. Texts of Rust are string literals outside tests: messages, help, pages; only their
phrases count. EXCEPTIONS has the exceptions, each with its reason.

Usage: python3 scripts/check-words.py [--count] [FILE...]
"""

import argparse
import ast
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
STYLE = ROOT / "docs" / "maintainers" / "style.md"
LONGEST = 35
# phrases that the table of the page names; where it has several, what they have in common
PHRASES = {
    r"goes on|go on from sample to sample": "is discrete-time; continues, advances",
    r"(?:is|are) no numbers?\b|what is not a number": "NaN; not finite",
    r"\b(?:an)?other tools?['’]s?|other people['’]s": "third-party",
    r"what is left(?: over)?\b": "residual; remainder",
    r"\bis told\b": "receives",
    r"\bis asked for\b|\bwho is asked\b": "is evaluated, queried; callee",
    r"\bis looked (?:at|for)\b": "is checked; is searched",
    r"\bfound out\b": "detected",
    r"\ba start that is off\b": "a perturbed initial state",
    r"\bdrawn nodes\b|\brandom nodes\b": "random features",
    r"\bof its own\b|\bof their own\b|\bby itself\b|\bby themselves\b": "separate; alone",
    r"\bat the (?:most|least)\b": "at most, at least",
    r"\bin the course of time\b": "over time",
    r"\bgiven away\b": "is released",
    r"\bheeds?\b|\bheeded\b": "respect, follow",
    r"\bin words\b": "as text",
    r"\bpart of a sampling\b": "shard",
    r"\bthat there (?:is|are) not\b|\bthere (?:is|are) not\b": "does not exist, unknown, missing",
    r"\b(?:that|so) many\b": "out of N; the number",
    r"\bcame of\b": "result of",
    r"\bdid not fail\b": "successful",
    r"\bas there\b(?! (?:is|are)\b)|\blikewise\b|\bsee there\b": "repeat the noun, or link to the item",
    r"\bas it is today\b|\bwhat is not done\b": "a limit, once",
}
OPENINGS = re.compile(r"^(?:Of |That of |Those of |Likewise|As there|[Ww]hat |[Ww]hether |The same\b|As above)")
# pages whose sentences may be long: messages list every name that is expected
LISTS = {ROOT / "docs" / "bad-input.md"}
# regular expressions of sentences, each with its reason
EXCEPTIONS = {
    r"^What (?:is|does|happens|changes|can)\b.*\?$": "a heading that asks a question",
}
ABBREVIATION = re.compile(r"\b(?:e\.g|i\.e|et al|vs|cf|approx|Fig|Eq|No|H|S)\.$")


def sentences(paragraph):
    """Sentences of a paragraph, with code as one word each."""
    text = re.sub(r"``?[^`]*``?", "CODE", paragraph.replace("<br>", ". "))
    text = re.sub(r"!?\[([^\]]*)\](?:\([^)]*\)|\[[^\]]*\])?", r"\1", text)
    text = re.sub(r"[*_]{1,2}(\w[^*_]*)[*_]{1,2}", r"\1", text)
    start = 0
    for match in re.finditer(r"[.!?][)\"”']*(?=\s+(?:[A-Z\"“(`]|metafmu\b|onnx2fmu\b)|\s*$)|:\s*$", text):
        if ABBREVIATION.search(text[: match.start() + 1]):
            continue
        yield text[start : match.end()].strip()
        start = match.end()
    if text[start:].strip():
        yield text[start:].strip()


def words(sentence):
    return len([word for word in re.split(r"\s+", sentence) if re.search(r"\w", word)])


def markdown(lines):
    """Line and text of each paragraph, list item and table cell."""
    paragraph, begin, is_code = [], 0, False
    for number, line in enumerate([*lines, ""], 1):
        text = line.strip()
        fence = text.startswith("```")
        if fence:
            is_code = not is_code
        starts_item = re.match(r"[-*+] |\d+\. |#+ |\|", text)
        if not text or fence or is_code or starts_item or (line.startswith("    ") and not paragraph):
            if paragraph:
                yield begin, " ".join(paragraph)
                paragraph = []
            if not text or fence or is_code or (line.startswith("    ") and not starts_item):
                continue
        if text.startswith("|"):
            yield from ((number, cell.strip()) for cell in text.strip("|").split("|") if re.search("[a-z]", cell))
            continue
        if not paragraph:
            begin = number
        paragraph.append(re.sub(r"^(?:[-*+]|\d+\.|#+|>) ", "", text))


def commented(lines, mark):
    """Doc comments of Rust as pieces of Markdown: line of the first, lines."""
    block, begin = [], 0
    for number, line in enumerate([*lines, ""], 1):
        match = re.match(mark, line)
        if match:
            if not block:
                begin = number
            block.append(match[1])
        elif block:
            yield begin, block
            block = []


def c_comments(source):
    """Line and lines of each comment of C."""
    for match in re.finditer(r'"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])*\'|/\*(.*?)\*/|//([^\n]*)', source, re.S):
        if comment := match[1] or match[2]:
            yield source.count("\n", 0, match.start()) + 1, re.sub(r"(?m)^ *\* ?|^ ", "", comment).splitlines()


def strings(source):
    """Line and text of each string literal of Rust with three words and more, outside tests."""
    source = source.split("#[cfg(test)]\nmod tests {")[0]
    for match in re.finditer(r'//[^\n]*|"((?:\\.|[^"\\])*)"|\'(?:\\.|[^\'\\])\'', source, re.S):
        if match[1] and len(match[1].split()) > 2:
            yield source.count("\n", 0, match.start()) + 1, re.sub(r"\\\n\s*", "", match[1])


def texts(path):
    """Line, text, and whether it is the summary of a doc comment."""
    content = path.read_text(encoding="utf-8").splitlines()
    if path.suffix == ".md":
        yield from ((line, text, False) for line, text in markdown(content))
    elif path.suffix == ".rs":
        for mark in (r"\s*/// ?(.*)", r"\s*//! ?(.*)"):
            for begin, block in commented(content, mark):
                for index, (line, text) in enumerate(markdown(block)):
                    yield begin + line - 1, text, index == 0
    elif path.suffix in (".py", ".c", ".h"):
        for begin, block in (docstrings if path.suffix == ".py" else c_comments)("\n".join(content)):
            for index, (line, text) in enumerate(markdown(block)):
                yield begin + line - 1, text, index == 0


def docstrings(source):
    """Line and lines of each docstring of a module."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) and (text := ast.get_docstring(node)):
            yield node.body[0].lineno, text.splitlines()


def refused(line, text):
    """The refused phrases of a text."""
    for phrase, instead in PHRASES.items():
        if found := re.search(phrase, text, re.I):
            yield line, f"{found[0]!r}, expected {instead}: {text[max(0, found.start() - 30) : found.end() + 40]}"


def problems(path):
    if path.suffix == ".rs" and "tests" not in path.parts and path.stem != "tests":
        for line, text in strings(path.read_text(encoding="utf-8")):
            yield from refused(line, text)
    for line, text, is_summary in texts(path):
        for index, sentence in enumerate(sentences(text)):
            if any(re.search(exception, sentence) for exception in EXCEPTIONS):
                continue
            if words(sentence) > LONGEST and path.resolve() not in LISTS:
                yield line, f"{words(sentence)} words, expected at most {LONGEST}: {sentence[:70]}..."
            if is_summary and index == 0 and OPENINGS.search(sentence):
                yield line, f"summary opens with {sentence.split()[0]!r}, expected the noun or \"Returns true if\": {sentence[:70]}"
            yield from refused(line, sentence)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", action="store_true", help="numbers by folder instead of places")
    parser.add_argument("files", nargs="*", type=Path)
    options = parser.parse_args()
    listed = subprocess.run(["git", "ls-files", "*.md", "*.rs", "*.py", "*.c", "*.h"], cwd=ROOT, capture_output=True, text=True, check=True)
    files = options.files or [ROOT / name for name in listed.stdout.split()]
    files = [file for file in files if file.resolve() != STYLE]
    found = [(file, line, problem) for file in files for line, problem in problems(file)]
    if options.count:
        counts = {}
        for file, _, problem in found:
            kind = "length" if " words, expected" in problem else "opening" if problem.startswith("summary") else "phrase"
            key = (file.resolve().relative_to(ROOT).parts[0], kind)
            counts[key] = counts.get(key, 0) + 1
        for (folder, kind), count in sorted(counts.items()):
            print(f"{count:6} {kind:8} {folder}")
    else:
        for file, line, problem in found:
            print(f"{file.resolve().relative_to(ROOT)}:{line}: {problem}")
    print(f"{len(found)} problems in {len(files)} files")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
