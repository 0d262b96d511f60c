"""Figures in dark mode: a second set of colours in the SVG files of the site."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from docutils import nodes

DARK = {
    "#ffffff": "#14181e",  # the page
    "#000000": "#e6e6e6",
    "#222222": "#d0d0d0",
    "#262626": "#d0d0d0",
    "#777777": "#a0a0a0",
    "#bbbbbb": "#6a6f76",
    "#dddddd": "#353a42",
    "#cccccc": "#50555c",
    "#0072b2": "#4da8e0",
    "#009e73": "#3fc79e",
}
"""Colours of `armrig.plots` on a white page, each with its replacement on a dark page."""


def adapted(svg: str) -> str:
    """Return the SVG text with a style that uses the dark colours on a dark page.

    In an image, `prefers-color-scheme` follows the property `color-scheme` of the page.
    """
    rules = [
        f'[style*="{what}: {light}"]{{{what}:{dark} !important}}'
        for light, dark in DARK.items()
        for what in ("fill", "stroke")
    ]
    # Glyphs have no fill of their own: they are black by default.
    rules.append(f"svg{{fill:{DARK['#000000']}}}")
    style = f"<style>@media (prefers-color-scheme: dark){{{''.join(rules)}}}</style>"
    head, tag, rest = svg.partition("<defs>")
    return f"{head}{style}{tag}{rest}" if tag and "prefers-color-scheme" not in svg else svg


def _drawn_by_armrig(path: Path) -> bool:
    return path.suffix == ".svg" and "Matplotlib" in path.read_text(encoding="utf-8")[:2000]


def mark(app: Any, document: nodes.document) -> None:
    """Mark armrig's figures, so that they get no white background in dark mode.

    If there is a second file NAME-dark, light mode shows NAME, and dark mode shows NAME-dark.
    """
    for image in list(document.findall(nodes.image)):
        path = Path(app.srcdir, image["uri"])
        dark = path.with_stem(f"{path.stem}-dark")
        if _drawn_by_armrig(path):
            image["classes"].append("dark-light")
        elif dark.exists():
            second = image.copy()
            second["uri"] = str(dark.relative_to(app.srcdir))
            second["candidates"] = {"*": second["uri"]}
            app.env.images.add_file(app.env.docname, second["uri"])
            second["classes"] = ["only-dark", "dark-light"]
            image["classes"].append("only-light")
            image.parent.insert(image.parent.index(image) + 1, second)


def adapt(app: Any, failure: Exception | None) -> None:
    """Add the dark colours to the SVG files of the finished site."""
    if failure is None:
        for path in filter(_drawn_by_armrig, Path(app.outdir, "_images").iterdir()):
            path.write_text(adapted(path.read_text(encoding="utf-8")), encoding="utf-8")


def setup(app: Any) -> dict[str, bool]:
    """Connect to the events of Sphinx."""
    app.connect("doctree-read", mark)
    app.connect("build-finished", adapt)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
