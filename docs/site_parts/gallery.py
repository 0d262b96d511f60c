"""Gallery: each figure with the code that draws it. The reference also shows the figures."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from contextlib import chdir
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from site_parts.pages import GENERATED, write_page

SETTINGS = tomllib.loads(Path(__file__).with_name("gallery.toml").read_text(encoding="utf-8"))
BEFORE: str = SETTINGS["before"]
FIGURES: list[dict[str, Any]] = SETTINGS["figure"]
FOLDER = GENERATED / "gallery"


def drawn(code: str) -> Figure:
    """Run `BEFORE` and then the code, in a new namespace and a new folder; return the figure."""
    *statements, last = ast.parse(BEFORE + code).body
    if not isinstance(last, ast.Expr):
        raise TypeError(f"the last line is no figure: {ast.unparse(last)}")
    names: dict[str, Any] = {}
    with TemporaryDirectory() as folder, chdir(folder):
        exec(compile(ast.Module(statements, []), "gallery.toml", "exec"), names)
        figure = eval(compile(ast.Expression(last.value), "gallery.toml", "eval"), names)
    if not isinstance(figure, Figure):
        raise TypeError(f"{ast.unparse(last)} is a {type(figure).__name__}, not a figure")
    return figure


def draw_all() -> None:
    """Draw the figures whose code has changed since they were drawn."""
    for figure in FIGURES:
        source, file = FOLDER / f"{figure['name']}.txt", FOLDER / f"{figure['name']}.svg"
        text = BEFORE + figure["code"]
        if file.exists() and source.exists() and source.read_text(encoding="utf-8") == text:
            continue
        FOLDER.mkdir(parents=True, exist_ok=True)
        with plt.rc_context({"svg.hashsalt": "armrig"}):
            drawn(figure["code"]).savefig(file, metadata={"Date": None})
        plt.close("all")
        write_page(source, text)


def page() -> str:
    """Return the page of the gallery."""
    text = [
        "# Gallery",
        "After this page you know the figures of armrig and the code that draws each figure. "
        "Run these lines first:",
        f"```python\n{BEFORE.strip()}\n```",
    ]
    for section, figures in groupby(FIGURES, key=lambda figure: str(figure["section"])):
        text.append(f"## {section}")
        for figure in figures:
            text += [f"### {figure['title']}", f"```python\n{figure['code'].strip()}\n```"]
            text.append(f"![{figure['title']}](gallery/{figure['name']}.svg)")
    return "\n\n".join(text) + "\n"


def _figures_of(name: str) -> Iterator[dict[str, Any]]:
    return (figure for figure in FIGURES if name in figure["shown_at"])


def add_figure(
    _app: Any, _what: str, name: str, _object: Any, _options: Any, lines: list[str]
) -> None:
    """Append the figures of a public name to its docstring."""
    for figure in _figures_of(name.removeprefix("armrig.")):
        lines += ["", f".. figure:: /docs/generated/gallery/{figure['name']}.svg"]
        lines += [f"   :alt: {figure['title']}", "", f"   {figure['title']}.", ""]


def _generate(*_: object) -> None:
    draw_all()
    write_page(GENERATED / "gallery.md", page())


def setup(app: Any) -> dict[str, bool]:
    """Draw the figures before Sphinx looks for its sources."""
    app.connect("config-inited", _generate)
    app.connect("autodoc-process-docstring", add_figure)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
