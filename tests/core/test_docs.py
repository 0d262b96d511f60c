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


def test_contributing_describes_the_address_that_the_owner_fills_in() -> None:
    readme, contributing = (ROOT / name for name in ("README.md", "CONTRIBUTING.md"))
    [address] = re.findall(r"^git clone (\S+)$", readme.read_text(), re.MULTILINE)

    assert f"`{address}` in README.md" in contributing.read_text()


@pytest.mark.parametrize("package", FOLDERS)
def test_the_architecture_page_has_a_line_for_each_package(package: str) -> None:
    page = (ROOT / "ARCHITECTURE.md").read_text()
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    contracts = settings["tool"]["importlinter"]["contracts"]
    (layers,) = (c["layers"] for c in contracts if c.get("containers") == [package])
    rooms = {room for layer in layers for room in layer.replace(" ", "").split("|")}
    rooms -= {"__main__"}

    names = {r: f"{r}/" if (FOLDERS[package] / r).is_dir() else f"{r}.py" for r in rooms}
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    assert {r for r in rooms if not any(f"`{names[r]}`" in row for row in rows)} == set()


def test_each_module_that_a_page_names_exists() -> None:
    homes = (ROOT, ROOT / "daemon", *FOLDERS.values(), ROOT / "firmware_protocol")
    named = {(p, x) for p in PAGES for x in re.findall(r"`([\w/]+/\w+\.py)`", p.read_text())}

    assert named
    assert {x for x in named if not any((home / x[1]).is_file() for home in homes)} == set()


def test_each_page_that_a_page_links_to_exists() -> None:
    link = re.compile(r"\]\((?!https?:|#)([^)#]+)(?:#[^)]*)?\)")
    targets = {(p, (p.parent / x).resolve()) for p in PAGES for x in link.findall(p.read_text())}

    assert targets
    assert {x for x in targets if not x[1].exists() and GENERATED not in x[1].parents} == set()


@pytest.mark.parametrize(
    ("package", "name", "edges"),
    [
        ("armrig", "Clients: nothing touches", "__main__ cli dashboard report lab rig plots"),
        ("armrig_daemon", "Daemon: nothing touches", "__main__ command_line"),
    ],
)
def test_a_module_is_pure_or_a_listed_edge(package: str, name: str, edges: str) -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    (layers,) = (c["layers"] for c in settings["contracts"] if c.get("containers") == [package])
    (pure,) = (c for c in settings["contracts"] if c["name"].startswith(name))

    rooms = {room.strip() for layer in layers for room in layer.split("|")}
    assert {*pure["source_modules"]} == {f"{package}.{room}" for room in rooms - {*edges.split()}}
    assert f"{package}.** -> *" not in pure["ignore_imports"]
