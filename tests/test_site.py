"""The site of docs/: what each page says first, which names the reference lists, and its parts."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import armrig
import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS))
PAGES = [
    path
    for path in sorted(DOCS.rglob("*.md"))
    if not {"generated", "decisions", "benchmarks"} & set(path.parts)
]
_FIRST_COMMAND = re.compile(r"^```(?:sh|python)$|`armrigd? [a-z]", re.MULTILINE)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_a_page_begins_with_what_its_reader_can_do_afterwards(page: Path) -> None:
    title, first, *_ = page.read_text(encoding="utf-8").split("\n\n")

    assert title.startswith("# ")
    assert first.startswith(("After ", "armrig records data"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_the_first_command_of_a_page_is_on_the_first_two_screens(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    if command := _FIRST_COMMAND.search(text):
        assert len(text[: command.start()].split()) <= 600


def test_the_reference_lists_each_public_name_once() -> None:
    text = (DOCS / "python.md").read_text(encoding="utf-8")

    for package, prefix in (
        (armrig, ""),
        (armrig.control, "~control."),
        (armrig.physics, "~physics."),
    ):
        listed = re.findall(rf"^   {prefix}(\w+)$", text, re.MULTILINE)
        assert sorted(listed) == sorted(package.__all__)


def test_each_code_of_the_reference_has_its_meaning() -> None:
    pytest.importorskip("sphinx")
    from armrig_daemon.decisions.faults import Id
    from site_parts.codes import meanings

    assert list(meanings(Id)) == list(Id)
    assert all(meanings(Id).values())


def test_a_broken_link_is_reported(tmp_path: Path) -> None:
    pytest.importorskip("sphinx")
    from site_parts.counts import dead_links

    (tmp_path / "a.html").write_text('<a href="b.html#there"></a><a href="b.html#gone"></a>')
    (tmp_path / "b.html").write_text('<p id="there"><a href="c.html"></a><a href="https://c"></a>')

    assert dead_links(tmp_path) == ["a.html: b.html#gone", "b.html: c.html"]


def test_a_state_diagram_becomes_a_table() -> None:
    pytest.importorskip("sphinx")
    from site_parts.languages import with_tables

    text = "a\n\n```mermaid\nstateDiagram-v2\n    [*] --> x\n    x --> y: a fault\n```\n\nb"

    assert (
        with_tables(text)
        == "a\n\n| from | to | when |\n| --- | --- | --- |\n| `x` | `y` | a fault |\n\nb"
    )


def test_a_figure_has_colours_for_light_and_dark() -> None:
    from site_parts.figures import DARK, adapted

    drawn = adapted('<svg><defs></defs><path style="fill: #ffffff"/></svg>')

    assert f'[style*="fill: #ffffff"]{{fill:{DARK["#ffffff"]} !important}}' in drawn
    assert "(prefers-color-scheme: dark)" in drawn
    assert adapted(drawn) == drawn


def test_bars_in_a_docstring_are_not_a_substitution() -> None:
    pytest.importorskip("sphinx")
    from site_parts.docstrings import with_bars

    text = ["|G| and ``|H|`` ::", "", "    |u| <= 5", "", ">>> a | b", "|c|", "", "|d|"]

    assert list(with_bars(text)) == [
        "\\|G\\| and ``|H|`` ::",
        *text[1:7],
        "\\|d\\|",
    ]
