"""The pages have no placeholder, and the names in them exist."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
GENERATED = ROOT / "docs" / "generated"  # `make docs` writes and checks these pages
PAGES = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("firmware_protocol/*.md")]
PAGES = [page for page in PAGES if GENERATED not in page.parents]
FOLDERS = {"armrig": ROOT / "clients/armrig", "armrig_daemon": ROOT / "daemon/armrig_daemon"}


def test_no_page_has_a_placeholder() -> None:
    found = {p.name: re.findall(r"@[A-Z]+@|\bTODO\b|\bMEASURE\b", p.read_text()) for p in PAGES}

    assert len(PAGES) > 10
    assert {name: gaps for name, gaps in found.items() if gaps} == {}


@pytest.mark.parametrize("package", FOLDERS)
def test_the_architecture_has_a_line_for_each_room(package: str) -> None:
    page = (ROOT / "ARCHITECTURE.md").read_text()
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    contracts = settings["tool"]["importlinter"]["contracts"]
    (layers,) = (c["layers"] for c in contracts if c.get("containers") == [package])
    rooms = {room for layer in layers for room in layer.replace(" ", "").split("|")}
    rooms -= {"__main__"}

    names = {r: f"{r}/" if (FOLDERS[package] / r).is_dir() else f"{r}.py" for r in rooms}
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    assert {r for r in rooms if not any(f"`{names[r]}`" in row for row in rows)} == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_module_that_a_page_names_is_there(page: Path) -> None:
    named = re.findall(r"`([\w/]+/\w+\.py)`", page.read_text())
    homes = (ROOT, ROOT / "daemon", *FOLDERS.values(), ROOT / "firmware_protocol")

    assert {name for name in named if not any((home / name).is_file() for home in homes)} == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_that_a_page_links_to_is_there(page: Path) -> None:
    links = re.findall(r"\]\((?!https?:|#)([^)#]+)(?:#[^)]*)?\)", page.read_text())
    targets = {(page.parent / link).resolve() for link in links}

    assert {
        path for path in targets if not path.exists() and GENERATED not in path.parents
    } == set()
