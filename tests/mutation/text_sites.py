"""The bugs that can be planted in C and in the page's JavaScript: one edit of a line each.

What only a person or another build reads is left alone: comments, texts, tables, assertions, and
what a PC has no use for (interrupts off and on, the hardware's watchdog).
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from tests.mutation.mutant import Mutant

_SWAPS = {
    "<": {"<=": "boundary", ">=": "condition inverted"},
    "<=": {"<": "boundary", ">": "condition inverted"},
    ">": {">=": "boundary", "<=": "condition inverted"},
    ">=": {">": "boundary", "<": "condition inverted"},
    "==": {"!=": "condition inverted"},
    "!=": {"==": "condition inverted"},
    "===": {"!==": "condition inverted"},
    "!==": {"===": "condition inverted"},
    "!": {"": "condition inverted"},
    "&&": {"||": "and/or"},
    "||": {"&&": "and/or"},
    "??": {"&&": "wrong default"},
    "+": {"-": "arithmetic"},
    "-": {"+": "arithmetic"},
    "*": {"/": "arithmetic"},
    "/": {"*": "arithmetic"},
    "++": {"--": "arithmetic"},
    "--": {"++": "arithmetic"},
    "+=": {"-=": "arithmetic", "=": "stale value"},
    "-=": {"+=": "arithmetic", "=": "stale value"},
    "|=": {"&=": "arithmetic"},
    "&": {"|": "arithmetic"},
    "<<": {">>": "arithmetic"},
    ">>": {"<<": "arithmetic"},
    "%": {"/": "arithmetic"},
    "true": {"false": "constant"},
    "false": {"true": "constant"},
    "Math.min": {"Math.max": "neighbour"},
    "Math.max": {"Math.min": "neighbour"},
    "[0]": {".at(-1)": "neighbour"},
    ".at(-1)": {"[0]": "neighbour"},
}
_TOKENS = re.compile(
    r"(?P<swap>=>|->|\?\.|[=!]==|<<=?|>>=?|<=|>=|==|!=|&&|\|\||\?\?|\+\+|--|\+=|-=|\|=|[<>+%!]"
    r"|(?<=\s)[-&*/](?=\s)|\b(?:true|false|Math\.m(?:in|ax))\b|(?<=\w)\[0\](?! =)|\.at\(-1\))"
    r"|(?P<number>(?<![\w.])\d[\d_]*(?:\.\d+)?(?:UL|U)?\b)"
)
_UNIT = re.compile(r" [*/] (1_?000(_?000)?U?L?|60|8U?)\b(?!\.)")
_ARGUMENTS = re.compile(r"(?<=\w\()(?<!Math\.m..\()(?P<one>[\w.&>-]+), (?P<two>[\w.&>-]+)(?=[,)])")
_CONDITION = re.compile(r"\b(?:if|while) \((?P<condition>.+)\)[^()]*$")
_STATEMENT = re.compile(
    r"^\s+(?!return|const|let|uint|int|bool|break|case|struct|enum|static|\.)(?P<all>\S.*;)$"
)
_LEFT_ALONE = re.compile(
    r"^\s*(#|//|\*|/\*|import|export \{|_Static_assert|0x)"
    r"|board_irq_|board_feed_watchdog|memset\(&rig, 0|volatile|console\."
)
_TEXT = re.compile(r"//.*$|\"[^\"]*\"|'[^']*'|`[^`]*`?|/\*.*\*/")


def sites(file: str, source: str) -> list[Mutant]:
    """Return the bugs that can be planted in a file."""
    found = []
    start = 0
    inside = file.endswith(".js")  # else in a function's body
    for number, line in enumerate(source.split("\n"), 1):
        if file.endswith(".c"):
            inside = line == "{" or (inside and not line.startswith("}"))
        if inside and line != "{" and not _LEFT_ALONE.search(line):
            code = _TEXT.sub(lambda text: "\0" * len(text[0]), line)  # what is read by a person
            found += [
                Mutant(file, number, kind, start + a, line[a:b], new)
                for kind, a, b, new in _edits(line, code)
            ]
        start += len(line) + 1
    return found


def _edits(line: str, code: str) -> Iterator[tuple[str, int, int, str]]:
    for found in _TOKENS.finditer(code):
        token = found.group()
        if found.lastgroup == "number":
            yield _of_number(token), *found.span(), _other(token)
        for new, kind in _SWAPS.get(token, {}).items():
            yield kind, *found.span(), new
    for unit in _UNIT.finditer(code):
        yield "unit", *unit.span(), ""
    for pair in _ARGUMENTS.finditer(code):
        yield "arguments swapped", *pair.span(), f"{pair['two']}, {pair['one']}"
    condition = _CONDITION.search(code)
    statement = _STATEMENT.match(code)
    if condition:
        first, last = condition.span("condition")
        yield "condition inverted", first, last, f"!({line[first:last]})"
    elif statement:
        kind = "stale value" if re.search(r"[^=!<>]=[^=>]", code) else "missing call"
        yield kind, *statement.span("all"), ";"


def _of_number(token: str) -> str:
    return "off by one" if _is_small(token) else "constant"


def _other(token: str) -> str:
    """Return one more; of a large number twice as much."""
    digits = token.rstrip("UL")
    value = float(digits) if "." in digits else int(digits)
    return f"{value + 1 if _is_small(token) else 2 * value}{token[len(digits) :]}"


def _is_small(token: str) -> bool:
    digits = token.rstrip("UL")
    return "." not in digits and int(digits) <= 10
