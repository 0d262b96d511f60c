"""Count what the style bans from pages, help, messages and docstrings; exit 1 if a room has more.

`python tests/words.py` prints for each room its banned phrases, its sentences with too many words
and its docstrings with a banned first word (tests/words.toml), and compares them with
tests/words_left.txt. Those numbers may only fall: `--write` stores lower ones. `--list ROOM` prints
each finding of a room. Quotations, code and tables are left out. If modules move to another room,
remove the table and store it again with `--write`: the sums must not rise.

`python tests/words.py --draw SEED` prints 100 sentences for a reader, who marks those that must be
read twice: the linter cannot see them.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import random
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
TABLE = Path(__file__).with_name("words_left.txt")
RULES = tomllib.loads(Path(__file__).with_name("words.toml").read_text(encoding="utf-8"))
KINDS = ("phrase", "long", "first")
"""A banned phrase, a sentence with too many words, a banned first word of a docstring."""
LEFT_OUT = (
    *("tests/words.py", "tests/words.toml", "tests/test_words.py", "tests/clients/cli/said"),
    *("docs/figures", "tests/data", "clients/armrig/dashboard/page/vendor"),
    "firmware_protocol/armrig_protocol/messages.py",
)
_PHRASES = {
    re.compile(rf"\b(?:{phrase})\b", re.IGNORECASE): better
    for phrase, better in RULES["phrases"].items()
}
_FIRST_WORDS = frozenset(RULES["first_words"]["words"])
_MOST_WORDS = RULES["sentences"]["most_words"]
_CODE = re.compile(r"``[^`]+``|`[^`\n]+(?:\n[^`\n]+)?`|\$[^$\n]+\$|<[^<>\n]+>")
_QUOTED = re.compile(r"[“\"][^”\"]{2,300}[”\"]")
_LINK = re.compile(r"!?\[([^]]*)\]\([^)]*\)")
_BLOCK = re.compile(r"\n\s*\n|\n(?=\s*(?:[-*+]|\d+\.)\s)")
_END = re.compile(r"(?:(?<=\w{3}[.!?])|(?<=[.!?])(?=\W+[^a-z]))[)”*_]*\s+|:\s*\n")
"""A period ends a sentence, but not after two letters (e.g.) if a small letter follows."""
_WORD = re.compile(r"[^\W\d_]")
_PROSE = re.compile(r"[^\W\d_]{2,},? [^\W\d_]{2,}")
_PAGE_TEXT = re.compile(r'"([^"\n]*)"|`([^`]*)`|>([^<>{}]+)<')
_LAYOUT = re.compile(r"^ *(?:[|>].*|#+ .*|-{3,}|={3,})$|^(?: {4,}|\t)(?![-*+\d]).*$", re.MULTILINE)
_FENCE = re.compile(r"^( *)```.*?^\1```", re.MULTILINE | re.DOTALL)
_LITERAL = re.compile(r"(?<=::\n)(?:\n| {4}.*(?:\n|$))+")
"""What follows `::` in a docstring, indented."""
_NAMES = re.compile(
    r"^.*\S.* : .*$|^ *[\w ]+\n *-{3,}$|^ *>>>.*$|^ *\.\. \[.*$|^ *\w+$", re.MULTILINE
)


class Finding(NamedTuple):
    """A sentence or docstring that the style bans."""

    kind: str
    line: int
    text: str


def _blank(match: re.Match[str]) -> str:
    """Return the line ends of a match, so that lines keep their numbers."""
    return "\n" * match[0].count("\n")


class Sentence(NamedTuple):
    """A sentence of a file; a name or a piece of code in it is an X."""

    line: int
    text: str


def page_findings(text: str) -> Iterator[Finding]:
    """Yield the findings of a page in Markdown."""
    return _judged(page_sentences(text))


def module_findings(source: str, *, quotes: bool = False) -> Iterator[Finding]:
    """Yield the findings of a Python module: in its docstrings, help texts and messages."""
    for text in _docstrings(ast.parse(source)):
        first = re.match(r"\w+", text.value.strip())
        if first and first[0] in _FIRST_WORDS:
            yield Finding("first", text.lineno, text.value.strip().partition("\n")[0])
    yield from _judged(module_sentences(source, quotes=quotes))


def script_findings(source: str) -> Iterator[Finding]:
    """Yield the findings of the dashboard's page: in the texts of its scripts and its HTML."""
    return _judged(script_sentences(source))


def page_sentences(text: str) -> Iterator[Sentence]:
    """Yield the sentences of a page in Markdown."""
    text = _LAYOUT.sub(_blank, _FENCE.sub(_blank, text))
    yield from _sentences(_LINK.sub(r"\1", text), 1)


def module_sentences(source: str, *, quotes: bool = False) -> Iterator[Sentence]:
    """Yield the sentences of a Python module: its docstrings, help texts and messages.

    The messages of a test are quotations (`quotes`), and are left out.
    """
    tree = ast.parse(source)
    docstrings = set(_docstrings(tree))
    parts = {v for n in ast.walk(tree) if isinstance(n, ast.JoinedStr) for v in ast.walk(n)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and node in docstrings:
            text = _LITERAL.sub(_blank, inspect.cleandoc(node.value))
            yield from _sentences(_NAMES.sub(_blank, text), node.lineno)
        elif quotes:
            continue
        elif isinstance(node, ast.JoinedStr):
            values = (v.value if isinstance(v, ast.Constant) else "N" for v in node.values)
            yield from _message("".join(map(str, values)), node.lineno)
        elif _is_text(node) and node not in parts:
            yield from _message(node.value, node.lineno)


def script_sentences(source: str) -> Iterator[Sentence]:
    """Yield the sentences in the texts of the page's scripts and its HTML."""
    for match in _PAGE_TEXT.finditer(source):
        text = re.sub(r"\$\{[^}]*\}", "N", next(t for t in match.groups() if t is not None))
        yield from _message(text, source.count("\n", 0, match.start()) + 1)


def _docstrings(tree: ast.AST) -> Iterator[ast.Constant]:
    """Yield the texts that are statements: docstrings, and those of fields."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and _is_text(node.value):
            yield node.value


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _message(text: str, line: int) -> Iterator[Sentence]:
    """Yield the sentences of a text that a program prints; a text without two words is a name."""
    for shown in text.split("\n"):
        if _PROSE.search(shown):
            yield from _sentences(shown, line)


def _sentences(text: str, line: int) -> Iterator[Sentence]:
    """Yield the sentences of prose that begins at a line."""
    for pattern in (_CODE, _QUOTED):
        text = pattern.sub(lambda m: "X" + _blank(m), text)
    for start, block in _split(_BLOCK, text):
        for at, sentence in _split(_END, block):
            where = line + text.count("\n", 0, start + at)
            where += len(sentence[: len(sentence) - len(sentence.lstrip())].splitlines()[1:])
            yield Sentence(where, " ".join(sentence.split()))


def _judged(sentences: Iterable[Sentence]) -> Iterator[Finding]:
    """Yield the findings of sentences."""
    for line, text in sentences:
        if sum(bool(_WORD.search(word)) for word in text.split()) > _MOST_WORDS:
            yield Finding("long", line, text)
        for phrase, better in _PHRASES.items():
            for found in phrase.findall(text):
                yield Finding("phrase", line, f"{found} (write: {better}): {text}")


def _split(pattern: re.Pattern[str], text: str) -> Iterator[tuple[int, str]]:
    start = 0
    for match in pattern.finditer(text):
        yield start, text[start : match.start()]
        start = match.end()
    yield start, text[start:]


_READERS = {
    ".md": (page_findings, page_sentences),
    ".py": (module_findings, module_sentences),
    ".js": (script_findings, script_sentences),
    ".html": (script_findings, script_sentences),
}


def room_of(path: Path) -> str:
    """Return the room of a file: a package's folder, a folder of pages, or a page of the root."""
    depth = {"docs": 2, "tests": 1, "deploy": 1, "firmware_protocol": 1}.get(path.parts[0], 3)
    return "/".join(path.parent.parts[:depth]) or path.name


def tree_files() -> Iterator[Path]:
    """Yield all files with prose that git lists or that are new."""
    call = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=True)
    for path in sorted({Path(line) for line in listed.stdout.splitlines()}):
        # A deleted file that is not committed is still listed.
        if (
            path.suffix in _READERS
            and not str(path).startswith(LEFT_OUT)
            and (ROOT / path).is_file()
        ):
            yield path


def tree_findings() -> Iterator[tuple[Path, Finding]]:
    """Yield the findings of all files."""
    for path in tree_files():
        text = (ROOT / path).read_text(encoding="utf-8")
        found = (
            module_findings(text, quotes=True)
            if path.suffix == ".py" and path.parts[0] == "tests"
            else _READERS[path.suffix][0](text)
        )
        yield from ((path, finding) for finding in found)


def drawn(seed: int, n: int = 100) -> list[tuple[Path, Sentence]]:
    """Return n sentences of at least four words that users and maintainers read; no tests."""
    found = [
        (path, sentence)
        for path in tree_files()
        if path.parts[0] != "tests"
        for sentence in _READERS[path.suffix][1]((ROOT / path).read_text(encoding="utf-8"))
        if len(_PROSE.findall(sentence.text)) >= 2
    ]
    return random.Random(seed).sample(found, n)


def read_table(text: str) -> Counter[tuple[str, str]]:
    """Return the stored number of each room and kind."""
    rows = (line.split() for line in text.splitlines() if line and not line.startswith("#"))
    return Counter(
        {(row[0], kind): int(n) for row in rows for kind, n in zip(KINDS, row[1:], strict=True)}
    )


def table(counts: Counter[tuple[str, str]]) -> str:
    """Return the numbers as a table, a line for each room that has any."""
    rooms = sorted({room for room, _ in counts if any(counts[room, kind] for kind in KINDS)})
    lines = [f"{'# room':34}" + "".join(f"{kind:>8}" for kind in KINDS)]
    lines += [f"{room:34}" + "".join(f"{counts[room, kind]:8}" for kind in KINDS) for room in rooms]
    return "\n".join(lines) + "\n"


def risen(
    counts: Counter[tuple[str, str]], stored: Counter[tuple[str, str]]
) -> list[tuple[str, str]]:
    """Return the rooms and kinds with more findings than stored."""
    return sorted(key for key in counts if counts[key] > stored[key])


def main() -> int:
    """Print the numbers by kind and room; return 1 if one is higher than the stored one."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--list", metavar="ROOM", help="print each finding of this room or file")
    parser.add_argument("--write", action="store_true", help="store the numbers that have fallen")
    parser.add_argument("--draw", metavar="SEED", type=int, help="print 100 drawn sentences")
    given = parser.parse_args()
    if given.draw is not None:
        for path, sentence in drawn(given.draw):
            print(f"{path}:{sentence.line}: {sentence.text}")
        return 0
    found = list(tree_findings())
    if given.list:
        for path, finding in found:
            if given.list in (room_of(path), str(path)):
                print(f"{path}:{finding.line}: {finding.kind}: {finding.text}")
        return 0
    counts = Counter((room_of(path), finding.kind) for path, finding in found)
    # Without a table the numbers of today are stored: how the table began.
    stored = read_table(TABLE.read_text(encoding="utf-8")) if TABLE.exists() else counts
    if given.write:
        TABLE.write_text(table(counts & stored), encoding="utf-8")
    print(table(counts), end="")
    print(
        f"{'all':34}"
        + "".join(f"{sum(counts[k] for k in counts if k[1] == kind):8}" for kind in KINDS)
    )
    higher = risen(counts, stored)
    for room, kind in higher:
        print(
            f"{room}: {counts[room, kind]} of kind {kind}, {stored[room, kind]} are stored:"
            f" `python tests/words.py --list {room}` prints them"
        )
    if counts & stored != stored and not given.write:
        print("lower than stored: `python tests/words.py --write`, and commit tests/words_left.txt")
    return 1 if higher else 0


if __name__ == "__main__":
    sys.exit(main())
