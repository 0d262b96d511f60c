"""Find what the style bans in pages, help, messages and docstrings; exit 1 if there is any.

`python tests/words.py` prints each banned phrase, each sentence with too many words and each
docstring with a banned first word (tests/words.toml). Quotations, code and tables are left out.
"""

from __future__ import annotations

import ast
import inspect
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
RULES = tomllib.loads(Path(__file__).with_name("words.toml").read_text(encoding="utf-8"))
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


def page_findings(text: str) -> Iterator[Finding]:
    """Yield the findings of a page in Markdown."""
    text = _LAYOUT.sub(_blank, _FENCE.sub(_blank, text))
    yield from _judged(_LINK.sub(r"\1", text), 1)


def module_findings(source: str, *, quotes: bool = False) -> Iterator[Finding]:
    """Yield the findings of a Python module: in its docstrings, help texts and messages.

    The messages of a test are quotations (`quotes`), and are left out.
    """
    tree = ast.parse(source)
    docstrings = set(_docstrings(tree))
    parts = {v for n in ast.walk(tree) if isinstance(n, ast.JoinedStr) for v in ast.walk(n)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and node in docstrings:
            text = inspect.cleandoc(str(node.value))
            if (first := re.match(r"\w+", text)) and first[0] in _FIRST_WORDS:
                yield Finding("first", node.lineno, text.partition("\n")[0])
            yield from _judged(_NAMES.sub(_blank, _LITERAL.sub(_blank, text)), node.lineno)
        elif quotes:
            continue
        elif isinstance(node, ast.JoinedStr):
            values = (v.value if isinstance(v, ast.Constant) else "N" for v in node.values)
            yield from _message("".join(map(str, values)), node.lineno)
        elif _is_text(node) and node not in parts:
            yield from _message(node.value, node.lineno)


def script_findings(source: str) -> Iterator[Finding]:
    """Yield the findings of the dashboard's page: in the texts of its scripts and its HTML."""
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


def _message(text: str, line: int) -> Iterator[Finding]:
    """Yield the findings of a text that a program prints; a text without two words is a name."""
    for shown in text.split("\n"):
        if _PROSE.search(shown):
            yield from _judged(shown, line)


def _judged(text: str, line: int) -> Iterator[Finding]:
    """Yield the findings of prose that begins at a line; a name or piece of code is an X."""
    for pattern in (_CODE, _QUOTED):
        text = pattern.sub(lambda m: "X" + _blank(m), text)
    for start, block in _split(_BLOCK, text):
        for at, part in _split(_END, block):
            where = line + text.count("\n", 0, start + at)
            where += len(part[: len(part) - len(part.lstrip())].splitlines()[1:])
            sentence = " ".join(part.split())
            if sum(bool(_WORD.search(word)) for word in sentence.split()) > _MOST_WORDS:
                yield Finding("long", where, sentence)
            for phrase, better in _PHRASES.items():
                for found in phrase.findall(sentence):
                    yield Finding("phrase", where, f"{found} (write: {better}): {sentence}")


def _split(pattern: re.Pattern[str], text: str) -> Iterator[tuple[int, str]]:
    start = 0
    for match in pattern.finditer(text):
        yield start, text[start : match.start()]
        start = match.end()
    yield start, text[start:]


_READERS = {
    ".md": page_findings,
    ".py": module_findings,
    ".js": script_findings,
    ".html": script_findings,
}


def tree_findings() -> Iterator[tuple[str, Finding]]:
    """Yield path and finding of all files with prose that git lists or that are new."""
    call = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=True)
    for path in sorted({*listed.stdout.splitlines()}):
        file = ROOT / path
        # A deleted file that is not committed is still listed.
        if file.suffix not in _READERS or path.startswith(LEFT_OUT) or not file.is_file():
            continue
        text = file.read_text(encoding="utf-8")
        if file.suffix == ".py":
            found = module_findings(text, quotes=path.startswith("tests/"))
        else:
            found = _READERS[file.suffix](text)
        yield from ((path, finding) for finding in found)


def main() -> int:
    """Print the findings; return 1 if there is any."""
    found = [f"{path}:{x.line}: {x.kind}: {x.text}" for path, x in tree_findings()]
    print("\n".join(found) or "no banned words")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
