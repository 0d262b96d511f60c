"""The page consists of files of the package, and obeys its own policy."""

from __future__ import annotations

import re
from pathlib import Path

import armrig.dashboard
from armrig.dashboard.app import PAGE_FILES

PAGE = Path(armrig.dashboard.__file__).parent / "page"
OWN = [path for path in PAGE.iterdir() if path.suffix in (".js", ".html", ".css")]


def test_every_file_of_the_page_exists_and_is_served() -> None:
    there = {str(p.relative_to(PAGE)) for p in PAGE.rglob("*") if p.is_file()}

    assert {*PAGE_FILES.values()} == there


def test_external_text_is_never_inserted_as_markup() -> None:
    forbidden = r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|new Function"
    for path in OWN:
        assert not re.search(forbidden, path.read_text()), path.name
    html = (PAGE / "index.html").read_text()
    assert not re.search(r"<script(?![^>]*src=)|\son\w+=|\sstyle=|<style", html)


def test_the_page_loads_no_file_from_another_host() -> None:
    for path in OWN:
        assert not re.search(r"https?://(?!www\.w3\.org)", path.read_text()), path.name


def _luminance(colour: str) -> float:
    channels = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _contrast(a: str, b: str) -> float:
    dark, light = sorted((_luminance(a), _luminance(b)))
    return (light + 0.05) / (dark + 0.05)


def test_all_text_has_a_contrast_ratio_of_at_least_4_5() -> None:
    """WCAG 2.1, AA, in both themes."""
    css = (PAGE / "dashboard.css").read_text()
    pairs = [(ink, ground) for ink in ("ink", "soft") for ground in ("ground", "card")]
    pairs += [(name, f"{name}-ground") for name in ("bad", "warn", "good")]
    pairs += [("accent-ink", "accent"), ("accent", "info-ground"), ("ink", "info-ground")]
    pairs += [(name, "card") for name in ("bad", "warn", "good")]
    themes = re.findall(r":root[^{]*\{([^}]*)\}", css)
    assert len(themes) == 2
    for theme in themes:
        colours = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", theme))
        for ink, ground in pairs:
            assert _contrast(colours[ink], colours[ground]) >= 4.5, (ink, ground)
    assert _contrast("#ffffff", "#b00020") >= 4.5
