"""The bugs that are planted: each is one, runs, and is drawn the same way again."""

from __future__ import annotations

import sys
from collections import Counter
from types import ModuleType

import pytest

from mutation.__main__ import LEAST, drawn, modules
from mutation.planting import Planted, plant
from mutation.sites import Site, planted, sites

SOURCE = '''
"""A module."""
LIMIT = 3


def clip(x: int, *, strict: bool = False) -> int:
    """Return x, at most the limit."""
    if x > LIMIT and not strict:
        x = LIMIT
    return x


def kind(x: object) -> str:
    """Return what x is."""
    match x:
        case int():
            return "number"
    return "nothing"
'''


def _module(number: int | None) -> dict[str, object]:
    """Return the names of the module, with a bug in it or without."""
    tree = compile(SOURCE, "module", "exec") if number is None else planted(SOURCE, number).tree
    names: dict[str, object] = {}
    exec(tree if number is None else compile(tree, "module", "exec"), names)  # type: ignore[arg-type]
    return names


def _seen(names: dict[str, object]) -> tuple[object, ...]:
    clip, kind = names["clip"], names["kind"]
    said = [clip(x, strict=s) for x in (1, 2, 3, 4, 9) for s in (False, True)]  # type: ignore[operator]
    return (*said, clip(9), kind(1), kind(""))  # type: ignore[operator]


def test_each_bug_is_one_and_runs() -> None:
    """Another statement than before, and a module that can be imported."""
    found = sites("m", SOURCE)

    assert [site.number for site in found] == list(range(len(found)))
    for site in found:
        bug = planted(SOURCE, site.number)
        assert bug.before != bug.after
        _module(site.number)


def test_most_bugs_show() -> None:
    """All but x >= 3 in the place of x > 3, which is the same function."""
    sound = _seen(_module(None))

    hidden = [s for s in sites("m", SOURCE) if _seen(_module(s.number)) == sound]

    assert Counter(site.kind for site in hidden) == Counter({"comparison": 1})


def test_what_only_a_person_reads_is_left_alone() -> None:
    """No bug in a docstring, an annotation, an import or a text."""
    text = 'import os\n"""Doc 5."""\nx: int\ny = "5"\n'
    assert sites("m", text) == []


def test_bugs_are_drawn_from_every_module_and_the_same_ones_again() -> None:
    """By the seed; a small module has a few of its own."""
    found = [Site("large", i, 1, "") for i in range(500)]
    found += [Site("small", i, 1, "") for i in range(10)]

    chosen = drawn(found, 50, 7)

    assert chosen == drawn(found, 50, 7) != drawn(found, 50, 8)
    assert Counter(site.module for site in chosen) == {"large": 49, "small": LEAST}
    assert len(set(chosen)) == len(chosen)


def test_a_bug_that_nobody_would_see_is_not_planted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its module was imported before."""
    monkeypatch.setitem(sys.modules, "already_there", ModuleType("already_there"))

    with pytest.raises(RuntimeError, match="already_there is imported already"):
        plant("already_there", planted(SOURCE, 0).tree)

    assert not any(isinstance(finder, Planted) for finder in sys.meta_path)


def test_bugs_are_planted_where_every_branch_is_covered() -> None:
    """One list for both."""
    assert {"armrig_daemon.core.step", "armrig_daemon.emulator.device"} <= set(modules())
