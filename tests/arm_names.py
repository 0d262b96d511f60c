"""Print the files with names of the arm; exit 1 if the code of other rooms contains them.

`python tests/arm_names.py`. A rig is described in a file, so the code reads the names of its
channels. The names of the arm remain in its physics, its calibration, its emulator and the report
of its handout: `[tool.armrig.arm_names]` of pyproject.toml has the numbers of files.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
SOURCES = ("clients/armrig", "daemon/armrig_core", "daemon/armrig_daemon")
ENDINGS = {".py", ".pyi", ".js", ".html", ".css", ".json", ".xml", ".toml"}
FREE_ROOMS = frozenset(
    [
        "decisions",
        "loop",
        "service",
        "recordings",
        "data",
        "estimation",
        "models",
        "validation",
        "dashboard",
        "plots",
    ]
)
"""Rooms that know channels only."""
NAMES = re.compile(r"(?<![a-z0-9])(?:theta_1|alpha|chassis|j_1|k_lin)(?![a-z0-9])", re.IGNORECASE)
_OPACITY = re.compile(r"\balpha(?=\s*=[^=]|\"\s*:)")  # an option of matplotlib
# The coefficients of a linear multistep method are alpha and beta in every textbook.
_MULTISTEP = "physics/integrators/"


class Found(NamedTuple):
    """Lines of a file that contain a name of the arm."""

    code: list[int]
    prose: list[int]
    """Lines of docstrings and comments, without examples: the example recording is of the arm."""


def main() -> int:
    """Print the files and their numbers of lines."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    most: dict[str, int] = settings["tool"]["armrig"]["arm_names"]
    found = files()
    for name, lines in found.items():
        print(f"{name:64} {len(lines.code):3} {len(lines.prose):3}")
    code = [name for name, lines in found.items() if lines.code]
    wrong = [f"{name}: names of the arm" for name in code if FREE_ROOMS & {*Path(name).parts}]
    for what, n in (("code", len(code)), ("with_prose", len(found))):
        print(f"{what} {n} of {most[what]}")
        if n > most[what]:
            wrong.append(f"names of the arm in {n} files ({what}): at most {most[what]}")
    print(*wrong, sep="\n")
    return 1 if wrong else 0


def files() -> dict[str, Found]:
    """Return the lines with names of the arm by file."""
    found = {}
    for source in SOURCES:
        for path in sorted((ROOT / source).rglob("*")):
            name = str(path.relative_to(ROOT))
            if path.suffix in ENDINGS and "vendor" not in path.parts and _MULTISTEP not in name:
                text = path.read_text(encoding="utf-8")
                if NAMES.search(text) and any(lines := lines_of(text, path.suffix)):
                    found[name] = lines
    return found


def lines_of(text: str, ending: str) -> Found:
    """Return the lines of a file that contain a name of the arm."""
    if ending not in (".py", ".pyi"):
        named = [n for n, line in enumerate(text.splitlines(), 1) if NAMES.search(line)]
        return Found(named, [])
    documented = {*_docstring_lines(ast.parse(text))}
    lines = text.splitlines()
    prose = [n for n in _without_examples(documented, lines) if NAMES.search(lines[n - 1])]
    code: list[int] = []
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if NAMES.search(token.string) and NAMES.search(_OPACITY.sub("", token.line)):
            if token.type == tokenize.COMMENT:
                prose.append(token.start[0])
            elif token.start[0] not in documented:
                code.append(token.start[0])
    return Found(code, prose)


def _docstring_lines(tree: ast.Module) -> Iterator[int]:
    for node in ast.walk(tree):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            continue
        for part in node.body:
            if isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant):
                yield from range(part.lineno, (part.end_lineno or part.lineno) + 1)


def _without_examples(documented: set[int], lines: list[str]) -> Iterator[int]:
    """Yield the lines of docstrings outside of examples, which end at an empty line."""
    is_example = False
    for n in sorted(documented):
        text = lines[n - 1].strip()
        is_example = text.startswith(">>>") or (is_example and bool(text))
        if not is_example:
            yield n


if __name__ == "__main__":
    sys.exit(main())
