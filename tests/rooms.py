"""Print the graph of rooms of clients, daemon and core; exit 1 at an arrow up or a circle.

`python tests/rooms.py`. The order of the rooms is that of import-linter's contracts in
pyproject.toml. All imports count between rooms, also imports inside of functions and for types
only, which the contracts omit. The package's own `__init__` counts, too; it is above all rooms but
the command line, which is a client of the public interface.
Inside a room an import for types only makes no circle, because it loads nothing. The groups of
files that import each other in this way are counted; the budget in pyproject.toml is the limit.
"""

from __future__ import annotations

import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

import grimp

ROOT = Path(__file__).parents[1]
PACKAGES = ("armrig", "armrig_daemon", "armrig_core")
FACE = "__init__"
Arrow = tuple[str, str]


def main() -> int:
    """Print the rooms from top to bottom, each with the rooms that it uses, and the faults."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    wrong = [text for package in PACKAGES for text in _checked(graph, package)]
    groups = _groups(graph)
    print(f"{len(groups)} groups of files import each other, also for types:")
    print(*(f"  {' '.join(group)}" for group in groups), sep="\n")
    if len(groups) > (most := _settings()["armrig"]["budget"]["file_circles"]):
        wrong.append(f"{len(groups)} groups of files import each other: at most {most}")
    wrong += _circles(
        grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True, cache_dir=None)
    )
    for text in wrong:
        print(text)
    return 1 if wrong else 0


def floors(package: str) -> dict[str, float]:
    """Return the floor of each room, 0 at the bottom."""
    contracts = _settings()["importlinter"]["contracts"]
    (layers,) = (c["layers"] for c in contracts if c.get("containers") == [package])
    rooms: dict[str, float] = {
        room.strip(): floor
        for floor, layer in enumerate(reversed(layers))
        for room in layer.split("|")
    }
    return rooms | {FACE: rooms.get("cli", len(layers) + 0.5) - 0.5}


def _settings() -> dict[str, Any]:
    tables: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return tables["tool"]


def _groups(graph: grimp.ImportGraph) -> list[list[str]]:
    """Return the groups of files that import each other, directly or through other files."""
    used = {module: graph.find_upstream_modules(module) for module in graph.modules}
    groups = {frozenset({m, *(u for u in used[m] if m in used[u])}) for m in used}
    return sorted(sorted(group) for group in groups if len(group) > 1)


def _room(package: str, module: str) -> str:
    return module.split(".")[1] if module != package else FACE


def _checked(graph: grimp.ImportGraph, package: str) -> Iterator[str]:
    floor = floors(package)
    arrows: defaultdict[Arrow, list[Arrow]] = defaultdict(list)
    for module in graph.modules:
        for used in graph.find_modules_directly_imported_by(module):
            if {module.split(".")[0], used.split(".")[0]} == {package}:
                arrow = _room(package, module), _room(package, used)
                if arrow[0] != arrow[1]:
                    arrows[arrow].append((module, used))
    print(f"{package}")
    for room in sorted(floor, key=lambda room: -floor[room]):
        below = sorted({b for a, b in arrows if a == room}, key=lambda room: -floor[room])
        print(f"  {room:14} {' '.join(below)}")
    for (a, b), imports in sorted(arrows.items()):
        if floor[a] <= floor[b]:
            yield f"{package}: {a} -> {b} points up:"
            for module, used in sorted(imports):
                yield from _lines(graph, module, used)


def _lines(graph: grimp.ImportGraph, module: str, used: str) -> Iterator[str]:
    for found in graph.get_import_details(importer=module, imported=used):
        yield f"    {module}:{found['line_number']}: {found['line_contents']}"


def _circles(graph: grimp.ImportGraph) -> Iterator[str]:
    # A package's __init__ is imported with each of its modules: it is no circle to be in it.
    imports = {
        module: [
            used
            for used in sorted(graph.find_modules_directly_imported_by(module))
            if not module.startswith(f"{used}.")
        ]
        for module in sorted(graph.modules)
    }
    while True:
        try:
            TopologicalSorter(imports).prepare()
        except CycleError as err:
            circle = err.args[1][::-1]  # each imports the next
            yield f"circle: {' -> '.join(circle)}"
            imports[circle[0]].remove(circle[1])
        else:
            return


if __name__ == "__main__":
    sys.exit(main())
