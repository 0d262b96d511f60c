"""Code blocks that the site shows without colours (nft) or as a table (mermaid's diagrams)."""

from __future__ import annotations

import re
from typing import Any

from pygments.lexers.special import TextLexer

from site_parts.pages import table

_DIAGRAM = re.compile(r"```mermaid\nstateDiagram-v2\n(.*?)```", re.DOTALL)
_ARROW = re.compile(r"(\w+) --> (\w+): (.+)")


def with_tables(text: str) -> str:
    """Replace the state diagrams of a page by tables, because mermaid would need a script."""

    def transitions(diagram: re.Match[str]) -> str:
        rows = [(f"`{a}`", f"`{b}`", when) for a, b, when in _ARROW.findall(diagram[1])]
        return table(("from", "to", "when"), *rows)

    return _DIAGRAM.sub(transitions, text)


def _replace(app: Any, page: str, source: list[str]) -> None:
    source[0] = with_tables(source[0])


def setup(app: Any) -> dict[str, bool]:
    """Register the language nft, and replace the diagrams when Sphinx reads a page."""
    app.add_lexer("nft", TextLexer)
    app.connect("source-read", _replace)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
