"""Bold verdicts and dim notes, on a terminal that shows them."""

from __future__ import annotations

import os
import pty
import subprocess
import sys

import pytest

BOLD, DIM = "\x1b[1m", "\x1b[2m"


def _shown(*, terminal: bool, **environment: str) -> str:
    """Return what `armrig integrate` prints on a terminal, or through a pipe."""
    ours, theirs = pty.openpty() if terminal else os.pipe()
    given = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "TERM")} | environment
    command = [sys.executable, "-m", "armrig", "integrate", "--method", "heun"]
    try:
        subprocess.run(command, stdout=theirs, stderr=theirs, env=given, check=True)
        return os.read(ours, 10_000).decode()
    finally:
        os.close(ours)
        os.close(theirs)


def test_the_verdict_is_bold_and_a_note_is_dim() -> None:
    first, *_, note, after = _shown(terminal=True, TERM="xterm").splitlines()

    assert first.startswith(f"{BOLD}least work")
    assert note.startswith(f"{DIM}--verbose: ")
    assert after.startswith("next: ")


@pytest.mark.parametrize(
    ("terminal", "environment"),
    [(False, {"TERM": "xterm"}), (True, {"NO_COLOR": "1"}), (True, {"TERM": "dumb"})],
)
def test_the_output_to_a_pipe_or_plain_terminal_is_plain_text(
    terminal: bool, environment: dict[str, str]
) -> None:
    assert "\x1b" not in _shown(terminal=terminal, **environment)
