"""CONTRIBUTING.md, SECURITY.md and the policy: what they name exists."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = ("CONTRIBUTING.md", "SECURITY.md", "docs/compatibility.md")
_SPAN = re.compile(r"`([\w.-]*/?[\w./-]+(?:/|\.\w+))(?:: ([\w.]+))?`")
"""A folder or file in code, and after a colon a name in it."""
_MAKE = re.compile(r"(?:`|^)make ([\w-]+)", re.MULTILINE)


def lacking(text: str) -> set[str]:
    """Return the files, names and make targets of a page that are not in the tree."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([\w-]+(?: [\w-]+)*):", makefile, re.MULTILINE))
    known = {target for line in targets for target in line.split()}
    spans = {span for span in _SPAN.findall(text) if "/" in span[0] or span[1]}
    return {": ".join(filter(None, span)) for span in spans if not _exists(*span)} | {
        f"make {target}" for target in _MAKE.findall(text) if target not in known
    }


def _exists(path: str, name: str) -> bool:
    file = ROOT / path
    if not name or not file.exists():
        return file.exists()
    text = file.read_text(encoding="utf-8")
    if file.suffix != ".py":
        return bool(re.search(rf"^\w[\w *]*\b{re.escape(name)}\(", text, re.MULTILINE))
    body: list[ast.stmt] = ast.parse(text).body
    for part in name.split("."):
        found = next((node for node in body if part in _names(node)), None)
        if found is None:
            return False
        body = getattr(found, "body", [])
    return True


def _names(node: ast.stmt) -> set[str]:
    """Return the names that a statement defines."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {node.name}
    targets = [*getattr(node, "targets", []), getattr(node, "target", None)]
    return {target.id for target in targets if isinstance(target, ast.Name)}


@pytest.mark.parametrize("page", PAGES)
def test_names_on_the_pages_for_maintainers_exist(page: str) -> None:
    assert lacking((ROOT / page).read_text(encoding="utf-8")) == set()


def test_contributing_names_a_function_for_each_step_of_a_sample() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")

    flows = re.findall(r"^## The flow of .*?(?=^## )", text, re.MULTILINE | re.DOTALL)

    hops = [re.findall(r"^\d+\. .*$", flow, re.MULTILINE) for flow in flows]
    assert [len(of_one) >= 9 for of_one in hops] == [True] * 3
    assert [hop for of_one in hops for hop in of_one if not _SPAN.search(hop)] == []


def test_the_name_of_a_decision_is_its_heading() -> None:
    files = sorted((ROOT / "docs" / "decisions").glob("*-*.md"))
    titles = [file.read_text(encoding="utf-8").partition("\n")[0] for file in files]

    assert files
    assert [file.stem for file in files] == [
        "-".join(re.findall(r"\w+", title.lower())) for title in titles
    ]
