"""Generated pages: their folder, their tables, and the function that writes them."""

from __future__ import annotations

from pathlib import Path

GENERATED = Path(__file__).parents[1] / "generated"
"""Folder of the generated sources; git ignores it."""


def write_page(path: Path, text: str) -> None:
    """Write a page if its text has changed; Sphinx then reads only the changed pages."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def table(*rows: tuple[str, ...]) -> str:
    """Return a Markdown table; the first row is its head."""
    cells = [[cell.replace("|", "\\|").replace("\n", " ") for cell in row] for row in rows]
    cells.insert(1, ["---"] * len(rows[0]))
    return "\n".join(f"| {' | '.join(row)} |" for row in cells)
