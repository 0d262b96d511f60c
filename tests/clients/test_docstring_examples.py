"""The examples in docstrings run and print what they show."""

from __future__ import annotations

import doctest
import re
from collections.abc import Iterator
from contextlib import ExitStack
from importlib import import_module
from inspect import getattr_static, isclass, isfunction
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import armrig
import armrig_core
import pytest
from armrig.rig.local_daemon import running

ROOTS = [Path(package.__path__[0]).parent for package in (armrig, armrig_core)]
MODULES = [
    ".".join(path.relative_to(root).with_suffix("").parts)
    for root, name in zip(ROOTS, ("armrig", "armrig_core"), strict=True)
    for path in sorted((root / name).rglob("*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]
STARTS_RIG = "running(["
"""Code of an example that starts its own emulated rig."""
LIVE = (STARTS_RIG, 'armrig.Rig("1")', 'armrig.stream("rig/1/')
"""Code of an example with a rig: it needs real time, two seconds each."""
MODELS = "armrig.models."
"""Examples that estimate the same few models, one each, which other tests do, too."""


def marks(example: doctest.DocTest) -> list[pytest.MarkDecorator]:
    """Return the marks of an example."""
    if _is_live(example):
        return [pytest.mark.real_time, pytest.mark.exhaustive]
    return [pytest.mark.exhaustive] if example.name.startswith(MODELS) else []


def _is_live(example: doctest.DocTest) -> bool:
    return any(code in example.docstring for code in LIVE)


EXAMPLES = [
    pytest.param(example, id=example.name, marks=marks(example))
    for module in MODULES
    for example in doctest.DocTestFinder().find(import_module(module))
    if example.examples
]


@pytest.fixture(autouse=True)
def own_directories(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Keep the socket, settings and recordings of an example apart from those of the user."""
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("s")))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_prints_its_output(
    example: doctest.DocTest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An example of `armrig` runs alone, with `armrig` and the names that it imports itself."""
    monkeypatch.chdir(tmp_path)
    if example.name.startswith("armrig."):
        example.globs = {"armrig": armrig}
    report: list[str] = []

    with ExitStack() as rig_runs:
        if _is_live(example) and STARTS_RIG not in example.docstring:
            rig_runs.enter_context(running(["--emulate"], rig="1", log=tmp_path / "log"))
        found = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(example, out=report.append)

    assert found.attempted
    assert not found.failed, "".join(report)


def test_a_name_in_a_docstring_can_be_imported() -> None:
    """`armrig.v1` is the package of the messages, not of Python."""
    packages = [root / name for root, name in zip(ROOTS, ("armrig", "armrig_core"), strict=True)]
    texts = [path.read_text() for package in packages for path in package.rglob("*.py")]
    named = {name for text in texts for name in re.findall(r"`(armrig\w*(?:\.\w+)+)", text)}

    assert all(resolve_name(name) for name in named if not name.startswith("armrig.v1"))


def test_a_public_name_has_an_example() -> None:
    """`help(armrig.oe)` and `help(armrig.Fit.save)` show how to call the function."""
    without = [
        full_name
        for package in (armrig, armrig.control, armrig.physics)
        for name in package.__all__
        for full_name, value in _documented(name, getattr(package, name))
        if ">>> " not in (value.__doc__ or "")
    ]

    assert not without, f"{len(without)} without an example: {', '.join(without)}"


def _documented(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield a function, or a class with its public methods, inherited methods included."""
    yield name, value
    if not isclass(value):
        return
    for method in dir(value):
        found = getattr_static(value, method)
        if isinstance(found, classmethod | staticmethod):
            found = found.__func__
        if isfunction(found) and not method.startswith("_"):
            yield f"{name}.{method}", found
