"""The bugs that can be planted in the C core: one token, or one statement, of a line each.

What only a person or another build reads is left alone: comments, tables, assertions, and what a
PC has no use for (interrupts off and on, the hardware's watchdog).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

_SWAPS = {
    "<": "<=",
    "<=": "<",
    ">": ">=",
    ">=": ">",
    "==": "!=",
    "!=": "==",
    "&&": "||",
    "||": "&&",
    "+": "-",
    "-": "+",
    "++": "--",
    "--": "++",
    "+=": "-=",
    "-=": "+=",
    "|=": "&=",
    "&": "|",
    "<<": ">>",
    ">>": "<<",
    "%": "/",
    "!": "",
    "true": "false",
    "false": "true",
}
_TOKENS = re.compile(
    r"(?P<swap><<=?|>>=?|<=|>=|==|!=|&&|\|\||\+\+|--|\+=|-=|\|=|->|[<>+%!]|(?<=\s)[-&](?=\s)"
    r"|\btrue\b|\bfalse\b)|(?P<number>(?<![\w.])\d+(?:UL|U)?\b)"
)
_CONDITION = re.compile(r"\b(if|while) \((?P<condition>.+)\)(?P<rest>[^()]*)$")
_STATEMENT = re.compile(
    r"^\s+(?!return|const|uint|int|bool|break|case|struct|enum|static|\.)\S.*;$"
)
_LEFT_ALONE = re.compile(
    r"^\s*(#|//|_Static_assert|0x)|board_irq_|board_feed_watchdog|memset\(&rig, 0|volatile"
)


class CoreSite(NamedTuple):
    """Where a bug can be planted, and the line with it."""

    file: str
    line: int
    kind: str
    before: str
    after: str


def sites(core: Path) -> list[CoreSite]:
    """Return all bugs that can be planted in the sources of a folder."""
    return [
        CoreSite(path.name, number, kind, line, after)
        for path in sorted(core.glob("*.c"))
        for number, line in _code(path.read_text())
        for kind, after in _bugs(line)
    ]


def planted(source: str, site: CoreSite) -> str:
    """Return a source with the bug in it."""
    lines = source.split("\n")
    lines[site.line - 1] = site.after
    return "\n".join(lines)


def _code(source: str) -> Iterator[tuple[int, str]]:
    inside = False  # a function's body
    for number, line in enumerate(source.split("\n"), 1):
        if line == "{":
            inside = True
        elif line.startswith("}"):
            inside = False
        elif inside and not _LEFT_ALONE.search(line):
            yield number, line


def _bugs(line: str) -> Iterator[tuple[str, str]]:
    code = line.split(" //")[0]
    for found in _TOKENS.finditer(code):
        token = found.group()
        if found.lastgroup == "number":
            digits = token.rstrip("UL")
            swapped = f"{int(digits) + 1}{token[len(digits) :]}"
            yield "off by one", code[: found.start()] + swapped + code[found.end() :]
        elif token in _SWAPS:
            yield token, code[: found.start()] + _SWAPS[token] + code[found.end() :]
    condition = _CONDITION.search(code)
    if condition:
        at = condition.span("condition")
        yield "negated", f"{code[: at[0]]}!({condition['condition']}){code[at[1] :]}"
    if _STATEMENT.match(code) and not condition:
        yield "dropped", re.sub(r"\S.*", ";", code, count=1)
