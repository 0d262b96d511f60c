"""No program reads a sentence: what another part decides by is a code or a number (design 2).

A sentence may be made anywhere. It is compared or searched only where the table says why.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("clients/armrig", "daemon", "firmware_protocol/armrig_protocol")
_PROSE = re.compile(r"[a-z]{3,}[,;:)]? |[ :;][a-z]{3,}|^[a-z]{3,}: ?$", re.IGNORECASE)
"""Words with a blank between or next to them: no key, no path, no unit."""
_SEARCHES = {"startswith", "endswith", "removeprefix", "removesuffix", "partition", "rpartition"}
_SEARCHES |= {"split", "rsplit", "find", "rfind", "index", "count", "replace"}
_PATTERNS = frozenset({"match", "search", "fullmatch", "findall", "finditer", "compile", "sub"})
_ASKED = (ast.Compare, ast.Call, ast.For, ast.comprehension)
_GRAMMAR = re.compile(r"\\.|\(\?[a-z:P<>!=]*|\[[^\]]*\]|[][^$.|?*+(){}]")
"""Parts of a regular expression that are no text."""

_OTHERS = "another program, a library or the system says it in words alone"
_SHOWN = "how a line is shown depends on it, and nothing else"
_OWN = "a name of several words, one of a closed list: no sentence"
_TYPST = "mathematics of Typst, and no sentence"
_USAGE = "clients/armrig/cli/usage_errors.py"
ALLOWED = {
    ("clients/armrig/cli/demo_rig.py", ": try again"): _SHOWN,
    ("clients/armrig/cli/validate.py", "open loop: "): _SHOWN,
    ("clients/armrig/cli/rig.py", "next: "): _SHOWN,
    ("clients/armrig/cli/rig.py", "in a browser: "): _SHOWN,
    (_USAGE, "Example: "): _SHOWN,
    (_USAGE, r"\S+: '(.+?)' is not one of (.+)$"): _OTHERS,
    (_USAGE, "Did you mean"): _OTHERS,
    (_USAGE, r"(\S+): (must be .*)$"): _OTHERS,
    (_USAGE, "^Option '(.+?)' requires an argument$"): _OTHERS,
    (_USAGE, r"Got unexpected extra arguments?(?:\(s\))? \((.+)\)$"): _OTHERS,
    (_USAGE, "No such command '(.+?)'"): _OTHERS,
    ("clients/armrig/models/equation.py", "thin +"): _TYPST,
    ("clients/armrig/models/equation.py", "thin ="): _TYPST,
    ("clients/armrig/recordings/files/verification.py", "held in a gap"): _OWN,
    ("clients/armrig/report/identification_sections.py", "armrig collect greybox"): _OWN,
    ("clients/armrig/validation/linearity.py", "gain by level"): _OWN,
    ("clients/armrig/validation/nonlinearity.py", "gain by level"): _OWN,
    (
        "clients/armrig/report/batch/cluster.py",
        r"tls://.+:\d+|(tcp://)?(localhost|127(\.\d+){3}|\[::1\]):\d+",
    ): "an address, and no sentence",
    ("clients/armrig/lab/avrdude.py", r"(Reading|Writing|Verifying) +\| (#*)"): _OTHERS,
    ("clients/armrig/lab/avrdude.py", r"Firmware Version *: *(\d+)\.(\d+)"): _OTHERS,
    ("clients/armrig/lab/avrdude.py", "avrdude(?: error| OS error)?: "): _OTHERS,
    (
        "clients/armrig/lab/avrdude.py",
        "expected signature for|invalid device signature",
    ): _OTHERS,
    (
        "clients/armrig/data/files/stamps.py",
        r"(?:(?P<days>-?\d+) days?,? \+?)?(?:(?P<h>\d{1,3}):)?(?P<m>\d{1,3}):"
        r"(?P<s>\d\d(?:[.,]\d+)?)\s*(?P<half>[AaPp]\.?[Mm]\.?)?",
    ): _OTHERS,
    (
        "clients/armrig/data/files/instrument_headers.py",
        r"(?:,\s*(?P<unit>[^,()]+?))?\s*\((?:LGR|SEN) S/N.*|,\s*GMT[-+]\d\d:\d\d$",
    ): _OTHERS,
    ("clients/armrig/data/files/stamps.py", "days (MATLAB's datenum)"): _OWN,
    ("clients/armrig/lab/fleet_recorder.py", "rig "): _SHOWN,
    ("clients/armrig/rig/local_daemon.py", "armrigd: "): _SHOWN,
    ("clients/armrig/lab/host.py", r"^flags\s*:.*\bhypervisor\b"): _OTHERS,
    ("daemon/armrig_core/access/owned_session.py", r"os error (\d+)"): _OTHERS,
    ("daemon/armrig_daemon/config.py", r"(?:{}) \(at line (\d+)"): _OTHERS,
    ("daemon/armrig_core/process/toml_file.py", "unknown field `(.+?)`"): _OTHERS,
    ("daemon/armrig_core/rig/description.py", "input name"): _OWN,
    ("daemon/armrig_core/rig/saved_model.py", '"armrig model"'): _OWN,
}
"""File and text, and why the file may look for it."""


def _words(text: str, *, is_pattern: bool = False) -> bool:
    return bool(_PROSE.search(_GRAMMAR.sub("", text) if is_pattern else text))


def _files() -> list[Path]:
    return sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


@cache
def _parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _named(tree: ast.Module) -> dict[str, str]:
    """Return the texts that a module gives a name to."""
    return {
        target.id: node.value.value
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
        for target in node.targets
        if isinstance(target, ast.Name) and isinstance(node.value.value, str)
    }


@cache
def _public() -> dict[str, str]:
    """Return the texts with a name that other modules may import."""
    named = [_named(_parsed(path)) for path in _files()]
    return {name: text for one in named for name, text in one.items() if name[0] != "_"}


def _of_tables(tree: ast.Module, nodes: list[ast.AST]) -> dict[str, str]:
    """Return a sentence for each name that runs over a column of sentences in a table."""
    tables = {
        target.id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    return {
        name.id: sentence
        for node in nodes
        if isinstance(node, ast.For | ast.comprehension) and isinstance(node.target, ast.Tuple)
        for table in ast.walk(node.iter)
        if isinstance(table, ast.Name) and table.id in tables
        for i, name in enumerate(node.target.elts)
        if isinstance(name, ast.Name) and (sentence := _sentence_in(tables[table.id], i))
    }


def _sentence_in(table: ast.expr, i: int) -> str:
    """Return a sentence of a table's column, "" if it has none."""
    if isinstance(table, ast.Dict):
        column: list[ast.expr | None] = [*(table.keys if i == 0 else table.values)]
    else:
        rows = getattr(table, "elts", [])
        column = [row.elts[i] for row in rows if isinstance(row, ast.Tuple) and i < len(row.elts)]
    texts = (cell.value for cell in column if isinstance(cell, ast.Constant))
    return next((x for x in texts if isinstance(x, str) and _words(x)), "")


def _texts(node: ast.expr, known: Mapping[str, str]) -> Iterator[str]:
    """Yield the texts of an operand: given, formatted, several in a tuple, or by a name."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.JoinedStr):
        yield "".join(v.value if isinstance(v, ast.Constant) else "{}" for v in node.values)
    elif isinstance(node, ast.Tuple | ast.Set | ast.List):
        for element in node.elts:
            yield from _texts(element, known)
    elif isinstance(node, ast.Name | ast.Attribute):
        name = node.id if isinstance(node, ast.Name) else node.attr
        if name in known:
            yield known[name]


def read_sentences(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and text of each sentence that a module compares with or searches for."""
    nodes = [n for n in ast.walk(tree) if isinstance(n, _ASKED)]
    known = {**_public(), **_named(tree), **_of_tables(tree, nodes)}
    for node in nodes:
        if isinstance(node, ast.Compare):
            sides = (node.left, *node.comparators)
            for text in (t for side in sides for t in _texts(side, known)):
                if _words(text):
                    yield node.lineno, text
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.args:
            of_re = isinstance(node.func.value, ast.Name) and node.func.value.id == "re"
            if node.func.attr in (_PATTERNS if of_re else _SEARCHES):
                for text in _texts(node.args[0], known):
                    if _words(text, is_pattern=of_re):
                        yield node.lineno, text


@pytest.mark.exhaustive
def test_no_program_reads_a_sentence() -> None:
    found = {
        (str(path.relative_to(ROOT)), text): line
        for path in _files()
        for line, text in read_sentences(_parsed(path))
    }

    unknown = [f"{file}:{found[file, text]}: {text!r}" for file, text in found.keys() - ALLOWED]

    assert not sorted(unknown)
    assert found.keys() >= ALLOWED.keys()
