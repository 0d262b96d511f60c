"""Print the size of the tree with its budget; exit 1 if a figure is over.

`python tests/budget.py`. The table `[tool.armrig.budget]` of pyproject.toml is a ceiling
with room. A commit that raises a figure does so by 500 and says what a user gets for it.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCE = ("daemon/", "clients/", "firmware_protocol/")
GENERATED = "firmware_protocol/armrig_protocol/messages.py"


def main() -> int:
    """Print a line for each figure."""
    text = _text("pyproject.toml")
    budget: dict[str, int] = tomllib.loads(text)["tool"]["armrig"]["budget"]
    found = sizes(text)
    for name, size in found.items():
        over = f", over by {size - budget[name]}" if size > budget[name] else ""
        print(f"{name:28} {size:7} of {budget[name]}{over}")
    return 1 if any(size > budget[name] for name, size in found.items()) else 0


def sizes(settings: str) -> dict[str, int]:
    """Return the figures of the budget; the argument is the text of pyproject.toml."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split("\0")
    files = [name for name in listed if name and (ROOT / name).is_file()]
    source = [f for f in files if f.startswith(SOURCE) and f.endswith(".py") and f != GENERATED]
    tests = [f for f in files if f.startswith("tests/")]
    stored = [f for f in tests if not f.endswith((".py", ".lock", ".md"))]
    tables = settings.split("\n[")
    contracts = [table for table in tables if table.lstrip("[").startswith("tool.importlinter")]
    return {
        "source_lines": _lines(source),
        "test_lines": _lines(name for name in tests if name.endswith(".py")),
        "stored_lines": _lines(stored),
        "page_words": sum(len(_text(name).split()) for name in files if name.endswith(".md")),
        "contract_lines": sum(len(table.split("\n")) for table in contracts),
        "contract_exceptions": "".join(contracts).count(" -> "),
    }


def _lines(names: Iterable[str]) -> int:
    return sum(_text(name).count("\n") for name in names)


def _text(name: str) -> str:
    """Return a file's text; a binary file has none."""
    data = (ROOT / name).read_bytes()
    return "" if b"\0" in data else data.decode(errors="ignore")


if __name__ == "__main__":
    sys.exit(main())
