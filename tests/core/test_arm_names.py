"""Only a few files name the quantities of the arm; all other rooms know channels."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
NAMES = re.compile(r"theta_1|alpha|chassis|J_1|K_lin")
MAX_FILES = 38
"""Number of files that name the arm's quantities; it only falls."""
WITHOUT = (
    *(f"daemon/armrig_daemon/{room}/" for room in ("decisions", "loop", "service")),
    *(
        f"clients/armrig/{room}/"
        for room in (
            *("recordings", "data", "estimation", "models", "validation", "dashboard", "plots"),
        )
    ),
)


def _words(tree: ast.AST) -> Iterator[str]:
    """Yield the identifiers and the strings, without docstrings and matplotlib's alpha."""
    ignored: set[int] = set()
    for node in ast.walk(tree):
        match node:
            case ast.Expr(value=ast.Constant() as text):
                ignored.add(id(text))
            case ast.Dict(keys=keys, values=values):
                pairs = zip(keys, values, strict=True)
                drawn = (key for key, x in pairs if isinstance(x, ast.Constant | ast.IfExp))
                ignored |= {
                    id(k) for k in drawn if isinstance(k, ast.Constant) and k.value == "alpha"
                }
    for node in ast.walk(tree):
        match node:
            case ast.Constant(value=str(text)) if id(node) not in ignored:
                yield text
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name):
                yield name
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.alias(name=name):
                yield name
            case ast.keyword(arg=str(name)) if name != "alpha":
                yield name


def test_the_arm_is_named_in_few_files_and_in_no_room_of_channels() -> None:
    found = {
        str(path.relative_to(ROOT))
        for folder in ("daemon", "clients", "firmware_protocol/armrig_protocol")
        for path in (ROOT / folder).rglob("*.py")
        if any(map(NAMES.search, _words(ast.parse(path.read_text(encoding="utf-8")))))
    }

    assert sorted(name for name in found if name.startswith(WITHOUT)) == []
    assert len(found) <= MAX_FILES, sorted(found)
