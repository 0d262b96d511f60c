"""Pages of docs/ whose Python and commands are run, and compared with the output they show."""

from __future__ import annotations

import importlib.util
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig.cli import main

DOCS = Path(__file__).parents[2] / "docs"
_BLOCK = re.compile(r"```(python|sh|text)\n(.*?)```", re.DOTALL)
_HASH = re.compile(r"\b[0-9a-f]{12}\b")
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


def script(name: str) -> Any:
    """Return a script of docs/figures as a module."""
    found = importlib.util.spec_from_file_location(f"figures_{name}", DOCS / "figures" / name)
    assert found is not None
    assert found.loader is not None
    module: Any = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def record_all(name: str, folder: Path) -> None:
    """Make the recordings of a page, by the script of its figures."""
    script(name).record_all(folder)


def run(
    page: Path,
    capsys: pytest.CaptureFixture[str],
    *,
    atol: float,
    commands: str | tuple[str, ...] | None = None,
) -> int:
    """Run a page's Python in the present folder; return how many printed texts were compared.

    If `commands` is not None, run the page's command lines that begin with one of them, too.
    The words must be the same; of the numbers the last digit may be another machine's.
    """
    names: dict[str, Any] = {}
    printed, compared = "", 0
    for language, text in _BLOCK.findall(page.read_text(encoding="utf-8")):
        if language == "python":
            exec(compile(text, str(page), "exec"), names)
        lines = text.splitlines() if commands and language == "sh" else []
        run = [line for line in lines if line.startswith(commands or "")]
        for line in run:
            assert main(shlex.split(line)[1:]) == 0, line
        if language == "python" or run:
            printed = capsys.readouterr().out
        if language != "text":
            continue
        assert without_numbers(printed) == without_numbers(text)
        np.testing.assert_allclose(numbers(printed), numbers(text), rtol=0.05, atol=atol)
        compared += 1
    return compared


def without_numbers(text: str) -> str:
    """Return the words; of a hash nothing is left."""
    return " ".join(_NUMBER.sub("#", _HASH.sub("", text)).split())


def numbers(text: str) -> list[float]:
    """Return the numbers of a text, those in hashes left out."""
    return [float(x) for x in _NUMBER.findall(_HASH.sub("", text))]
