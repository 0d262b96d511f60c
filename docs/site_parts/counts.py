"""Count a site's defects: dead links, public names without an example, options without help."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import armrig

from site_parts.commands import commands, options


class _Page(HTMLParser):
    """Links of a page, and the ids to which a link can point."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.places: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Store the links and the ids of a tag."""
        for key, value in attrs:
            if key in ("href", "src") and value:
                self.links.append(value)
            elif key == "id" or (key == "name" and tag == "a"):
                self.places.add(value or "")


def dead_links(site: Path) -> list[str]:
    """Return the links within a site whose target file or target id does not exist."""
    files = sorted(f for f in site.rglob("*.html") if "_static" not in f.relative_to(site).parts)
    pages = {path: _Page(path.read_text(encoding="utf-8")) for path in files}
    dead = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            place = unquote(parts.fragment)
            here = target.exists() and (
                not place or target not in pages or place in pages[target].places
            )
            if not here:
                dead.append(f"{path.relative_to(site)}: {link}")
    return dead


def public_names() -> Iterator[tuple[str, Any]]:
    """Yield the functions, classes and public methods of `armrig` and its public packages."""
    packages = (armrig, armrig.control, armrig.physics)
    for name, found in ((name, getattr(p, name)) for p in packages for name in p.__all__):
        yield name, found
        if inspect.isclass(found):
            yield from ((f"{name}.{key}", method) for key, method in _methods(found))


def _methods(cls: type) -> Iterator[tuple[str, Any]]:
    """Yield the methods that a class defines or inherits from classes of armrig."""
    for key, method in inspect.getmembers(
        cls, lambda m: inspect.isfunction(m) or inspect.ismethod(m)
    ):
        if not key.startswith("_") and method.__module__.startswith("armrig"):
            yield key, method


def names_without_example() -> list[str]:
    """Return the public names whose docstring has no example."""
    return [name for name, found in public_names() if ">>> " not in (inspect.getdoc(found) or "")]


def options_without_help() -> list[str]:
    """Return the arguments and options without a help text, of all commands."""
    return [
        f"{name} {spelling}"
        for name, command in commands()
        for _, spelling, text in options(name, command)
        if not text.strip()
    ]


def main() -> int:
    """Print the defects of the site in the given folder; return 1 if there is a defect."""
    missing = {
        "dead links": dead_links(Path(sys.argv[1])),
        "public names without an example": names_without_example(),
        "options without help": options_without_help(),
    }
    for what, found in missing.items():
        print(f"{len(found)} {what}", *found, sep="\n  ")
    return int(any(missing.values()))


if __name__ == "__main__":
    sys.exit(main())
