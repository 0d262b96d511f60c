"""Languages of code blocks that Pygments does not know; they are shown without colours."""

from __future__ import annotations

from typing import Any

from pygments.lexers.special import TextLexer


def setup(app: Any) -> dict[str, bool]:
    """Register the languages."""
    for language in ("mermaid", "nft"):
        app.add_lexer(language, TextLexer)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
