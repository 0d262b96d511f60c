"""`make` names a Python or a compiler that armrig cannot use, and installs only what has a hash."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests import audit
from tests.tools import needs

pytestmark = needs("make")
MAKEFILE = Path(__file__).parents[2] / "Makefile"


def program(path: Path, text: str) -> str:
    """Write a program for a shell, and return its path."""
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return str(path)


def made(*arguments: str, path: str = os.environ["PATH"]) -> str:
    """Return the first line that a failing `make` prints to standard error."""
    done = subprocess.run(
        # Without the variables of a `make test PYTHON=…` that runs this test.
        ["/usr/bin/env", "-i", f"PATH={path}", "make", "-f", MAKEFILE, *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    return done.stderr.splitlines()[0]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            '[ "$1" != -V ] || echo Python 3.10.13; [ "$1" = -V ]',
            "armrig needs Python 3.11 or later; {python} is Python 3.10.13; install it",
        ),
        ("exit 127", "armrig needs Python 3.11 or later; {python} is missing; install it"),
        (
            'case "$2" in *venv*) exit 1;; esac',
            "{python} has no venv; on Debian: apt install python3-venv",
        ),
    ],
)
def test_an_unsuitable_python_is_reported_with_the_remedy(
    tmp_path: Path, text: str, reason: str
) -> None:
    python = program(tmp_path / "python", text)

    line = made("-C", str(tmp_path), ".venv/bin/pip", f"PYTHON={python}")

    way_out = "or name another Python, for example: make .venv/bin/pip PYTHON=python3.12"
    assert re.split("[,;] (?=or name)", line) == [reason.format(python=python), way_out]
    assert not (tmp_path / ".venv").exists()


def environment(folder: Path) -> None:
    """Make the files of an environment of Python 3.11, which needs nothing more."""
    (folder / ".venv").mkdir()
    program(folder / ".venv/bin/pip", "")
    program(folder / ".venv/bin/python", "echo Python 3.11.2")
    for name in (
        "pyproject.toml",
        "requirements.lock",
        "requirements.build.lock",
        "tests/requirements.lock",
    ):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).touch()


def test_a_python_that_the_environment_does_not_have_is_refused(tmp_path: Path) -> None:
    environment(tmp_path)
    python = program(tmp_path / "python", "echo Python 3.12.1")

    said = made("-C", str(tmp_path), ".venv/dev", f"PYTHON={python}")

    assert said.startswith(f"PYTHON={python} is Python 3.12.1, but .venv has Python 3.11.2; remove")


def test_the_tests_name_a_missing_compiler(tmp_path: Path) -> None:
    environment(tmp_path)
    commands = tmp_path / "commands"
    commands.mkdir()
    for name in ("make", "sh"):
        (commands / name).symlink_to(f"/usr/bin/{name}")

    said = made("-C", str(tmp_path), ".venv/dev", path=str(commands))

    assert said.startswith("no C compiler (cc), which the tests need; on Debian: apt install gcc")


def test_each_installation_compares_hashes_or_downloads_nothing() -> None:
    trust = MAKEFILE.parent / "docs/trust.md"
    for text in (MAKEFILE.read_text(), trust.read_text()):
        lines = re.findall(r"^(?:\t\$\(PIP\)|pip install) (.*)$", text, re.MULTILINE)

        assert len(lines) > 1
        for line in lines:
            assert re.match(r"--require-hashes -r |--no-deps --no-build-isolation ", line), line


SKIPPED = {"name": "b", "skip_reason": "not found"}
CLEAN = {"name": "a", "version": "1", "vulns": []}
KNOWN = {"name": "c", "version": "2", "vulns": [{"id": "CVE-1", "fix_versions": ["3"]}]}


@pytest.mark.parametrize(
    ("packages", "code", "exits", "said"),
    [
        ([SKIPPED, SKIPPED], 0, 3, "nothing was audited: the index knows none of 2 packages\n"),
        ([SKIPPED, CLEAN], 0, 0, "1 of 2 packages were audited\n"),
        ([KNOWN, CLEAN], 1, 1, "c 2: CVE-1, fixed in 3\n2 of 2 packages were audited\n"),
    ],
)
def test_an_audit_that_skipped_every_package_is_a_failure(
    packages: list[object], code: int, exits: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = json.dumps({"dependencies": packages})
    program = [sys.executable, "-c", f"print({text!r}); raise SystemExit({code})"]

    assert audit.main(program) == exits
    assert capsys.readouterr().out == said


def test_a_failed_audit_is_a_failure() -> None:
    assert audit.main([sys.executable, "-c", "raise SystemExit(2)"]) == 2
    assert audit.main([sys.executable, "-c", ""]) == 1
