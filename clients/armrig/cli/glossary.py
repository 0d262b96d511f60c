"""The command that explains terms: glossary."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from armrig_core.errors import InputError
from armrig_core.process.options import argument

from armrig.cli.options import Json
from armrig.cli.printing import (
    print_result,
)

if TYPE_CHECKING:
    pass


_ENTRY = re.compile(r"^- \*\*(?P<term>[^*]+)\*\*(?: \((?P<long>[^)]+)\))?: (?P<text>.+)$", re.M)
_MAX_OFFERED = 3
"""Largest number of similar terms in the message about an unknown term."""


def glossary(
    term: Annotated[str | None, argument("TERM", "Term to explain.", "a list of all terms")] = None,
    json: Json = False,
) -> None:
    """Explain a term of armrig in one sentence, or list all terms."""
    terms = read_terms(_page().read_text(encoding="utf-8"))
    sentences = {term: terms[term] for term in ([_matching_term(term, terms)] if term else terms)}
    lines = (f"{name}: {text}" for name, text in sentences.items())
    print_result(sentences, *(lines if term else terms), json=json)


def read_terms(page: str) -> dict[str, str]:
    """Return the terms of the page with their sentences."""
    return {
        entry["term"]: (f"{entry['long']}. " if entry["long"] else "") + entry["text"]
        for entry in _ENTRY.finditer(page)
    }


def _page() -> Path:
    """Return the path of the page, in the wheel or in the checkout."""
    packaged = Path(__file__).parents[1] / "glossary.md"
    return packaged if packaged.is_file() else Path(__file__).parents[3] / "docs" / "glossary.md"


def _matching_term(term: str, terms: dict[str, str]) -> str:
    """Return the term that a text means, in any case and hyphenation, also in the plural."""
    from difflib import get_close_matches

    names = {_plain(name): name for name in terms}
    wanted = _plain(term)
    for form in (wanted, wanted.removesuffix("s")):
        if form in names:
            return names[form]
    containing = [name for name in names if wanted and wanted in name]
    near = list(dict.fromkeys([*containing, *get_close_matches(wanted, names)]))[:_MAX_OFFERED]
    offered = ", ".join(names[name] for name in near)
    way_out = f"nearest: {offered}" if near else "`armrig glossary` lists all terms"
    raise InputError(f"{term}: not in the glossary; {way_out}")


def _plain(term: str) -> str:
    return " ".join(re.split(r"[\s_-]+", term.strip().casefold()))
