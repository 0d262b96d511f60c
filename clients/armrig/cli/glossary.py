"""The command glossary: the terms of docs/glossary.md, which the wheel contains."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

from armrig_core.errors import InputError

from armrig.cli.options import Json, argument
from armrig.cli.printing import echo, print_json

Term = Annotated[str | None, argument("TERM", "Term to explain.", "a list of all terms")]
_ENTRY = re.compile(r"^- \*\*(?P<term>[^*]+)\*\*(?: \((?P<long>[^)]+)\))?: (?P<text>.+)$", re.M)
_MAX_OFFERED = 3
"""Largest number of similar terms in the message about an unknown term."""


def glossary(term: Term = None, json: Json = False) -> None:
    """Explain a term of armrig in one sentence, or list all terms."""
    terms = read_terms(_page().read_text(encoding="utf-8"))
    shown = {term: terms[term] for term in ([_found(term, terms)] if term else terms)}
    if json:
        print_json(shown)
    elif term:
        echo("\n".join(f"{name}: {text}" for name, text in shown.items()))
    else:
        echo("\n".join(terms))


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


def _found(term: str, terms: dict[str, str]) -> str:
    """Return the term that a text means, regardless of case, blanks, hyphens and underscores."""
    from difflib import get_close_matches

    names = {_plain(name): name for name in terms}
    wanted = _plain(term)
    if wanted in names:
        return names[wanted]
    containing = [name for name in names if wanted and wanted in name]
    near = list(dict.fromkeys([*containing, *get_close_matches(wanted, names)]))[:_MAX_OFFERED]
    offered = ", ".join(names[name] for name in near)
    way_out = f"nearest: {offered}" if near else "`armrig glossary` lists all terms"
    raise InputError(f"{term}: not in the glossary; {way_out}")


def _plain(term: str) -> str:
    return " ".join(re.split(r"[\s_-]+", term.strip().casefold()))
