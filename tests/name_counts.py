"""Count the names that a reader must guess in each room; exit 1 if there are too many.

- participles: functions whose name begins with a bare participle, such as `searched`
- filler: bindings whose whole name is a word that names no quantity, such as `found`
- meanings: names of classes that two or more modules define

The ceilings are in pyproject.toml, and the words in words.toml. Properties that are states, such as
`closed`, and names of a library's interface may remain.
"""

from __future__ import annotations

import ast
import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = ("daemon", "clients", "firmware_protocol")
_GENERATED = "messages.py"
_WORDS = tomllib.loads(Path(__file__).with_name("words.toml").read_text(encoding="utf-8"))["names"]
_IRREGULAR, _FILLER = frozenset(_WORDS["participles"]), frozenset(_WORDS["filler"])
_NO_PARTICIPLES = frozenset(_WORDS["no_participles"])
_STATES = frozenset({"property", "cached_property"})


def is_participle(name: str) -> bool:
    """Return whether the first word of a name is a bare participle."""
    first = name.strip("_").partition("_")[0]
    regular = len(first) > 3 and first.endswith("ed") and first not in _NO_PARTICIPLES
    return regular or first in _IRREGULAR


def names_of(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Yield each name to guess, after its kind."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and is_participle(node.name):
            marks = {getattr(d, "id", getattr(d, "attr", "")) for d in node.decorator_list}
            if not marks & _STATES:
                yield "participles", node.name
        name = node.arg if isinstance(node, ast.arg) else None
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            name = node.id
        if name and name.strip("_") in _FILLER:
            yield "filler", name


def count_names(root: Path = ROOT) -> tuple[Mapping[str, Counter[str]], int]:
    """Return the counts of each room by kind, and the number of ambiguous class names."""
    rooms: dict[str, Counter[str]] = defaultdict(Counter)
    modules: dict[str, set[Path]] = defaultdict(set)
    for path in (p for source in SOURCES for p in sorted((root / source).rglob("*.py"))):
        if path.name == _GENERATED:
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        room = "/".join(path.parent.relative_to(root).parts[:3])
        rooms[room].update(kind for kind, _ in names_of(tree))
        for node in tree.body:
            if isinstance(node, ast.ClassDef):
                modules[node.name.strip("_")].add(path)
    return rooms, sum(len(paths) > 1 for paths in modules.values())


def report_names() -> int:
    """Print the counts of each room; return 1 if a total is above its ceiling."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    ceilings: Mapping[str, int] = settings["tool"]["armrig"]["names"]
    rooms, meanings = count_names()
    totals: Counter[str] = sum(rooms.values(), Counter()) + Counter(meanings=meanings)
    print(f"{'names to guess':40}{'participles':>12}{'filler':>8}")
    for room, counts in sorted(rooms.items()):
        print(f"{room:40}{counts['participles']:12}{counts['filler']:8}")
    for kind, most in ceilings.items():
        print(f"{kind:12}{totals[kind]:6} of {most}")
    return int(any(totals[kind] > most for kind, most in ceilings.items()))


if __name__ == "__main__":
    sys.exit(report_names())
