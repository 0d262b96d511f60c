"""Code blocks that the site cannot colour (nft), or shows as a table (mermaid's state diagrams)."""

from __future__ import annotations

import re
from typing import Any

from pygments.lexers.special import TextLexer

from site_parts.pages import table

_DIAGRAM = re.compile(r"```mermaid\nstateDiagram-v2\n(.*?)```", re.DOTALL)
_ARROW = re.compile(r"(\w+) --> (\w+): (.+)")


def with_tables(text: str) -> str:
    """Return a page whose state diagrams are tables of transitions, because mermaid is a script."""

    def transitions(diagram: re.Match[str]) -> str:
        rows = [(f"`{a}`", f"`{b}`", when) for a, b, when in _ARROW.findall(diagram[1])]
        return table(("from", "to", "when"), *rows)

    return _DIAGRAM.sub(transitions, text)


def _replace(app: Any, page: str, source: list[str]) -> None:
    source[0] = with_tables(source[0])


def setup(app: Any) -> dict[str, bool]:
    """Register the language, and replace the diagrams of each page that is read."""
    app.add_lexer("nft", TextLexer)
    app.connect("source-read", _replace)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
