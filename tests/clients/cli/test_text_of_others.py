"""Names and reasons that others wrote are shown, and do nothing to a terminal."""

from __future__ import annotations

import json
import time
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from armrig.cli import main
from armrig.cli.printing import spinner, tell
from armrig.rig.collection import bar
from armrig_core.recording_file.manifest import Outcome
from rich.console import Console

from tests.clients.made_recordings import (
    event,
    gap,
    manifest,
    note,
    of_the_arm,
    recorded,
    sample,
    written,
)

HOSTILE = "\x1b]0;mine\x07\x1b[2Ja rig\r\n\x9b[red]\u202e"
SHOWN = r"\x1b]0;mine\x07\x1b[2Ja rig\r\n\x9b[red]\u202e"


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Give a recording whose every text is hostile."""
    told = manifest(
        run_id=HOSTILE,
        experiment=HOSTILE,
        details={HOSTILE: HOSTILE, "list": [HOSTILE]},
        started=HOSTILE,
        armrig=HOSTILE,
        protocol=HOSTILE,
        device={"uid": HOSTILE, "adc_bits": 10, "pwm_bits": 10},
        host={HOSTILE: HOSTILE},
    )
    messages = [sample(k) for k in range(5)] + [gap(5, 1, 1.0, HOSTILE)]
    messages += [sample(k) for k in range(6, 10)] + [event(9, HOSTILE)]
    messages += [note(9, HOSTILE, HOSTILE)]
    outcome = Outcome(outcome=HOSTILE, samples=9, missing=1)
    return written(tmp_path, recorded(messages, manifest=told, outcome=outcome))


def test_texts_of_a_recording_are_escaped_on_a_terminal(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(recording)]) == 0
    told = capsys.readouterr()

    assert told.out.replace("\n", "").isprintable()
    assert told.err.replace("\n", "").isprintable()
    for name in ("run", "experiment", "outcome", "gap", "note"):
        (line,) = (line for line in told.out.splitlines() if line.startswith(f"{name} "))
        assert SHOWN in line


def test_a_recording_as_json_keeps_its_texts(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(recording), "--json"]) == 0
    told = capsys.readouterr().out

    assert told[:-1].isprintable()
    facts = json.loads(told)
    assert facts["manifest"]["experiment"] == HOSTILE
    assert facts["outcome"]["outcome"] == HOSTILE
    assert facts["notes"] == [
        {"t": pytest.approx(0.09, abs=1e-3), "text": HOSTILE, "owner": HOSTILE}
    ]
    assert facts["gaps"][0]["reason"] == facts["events"][0]["message"] == HOSTILE


def test_the_name_of_a_file_is_escaped_on_a_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hostile = tmp_path / "\x1b[2J\x9b.mcap"
    assert main(["info", str(hostile)]) == 1
    hostile.write_bytes(of_the_arm(np.full(50, 1.0)))
    assert main(["info", str(hostile)]) == 0
    told = capsys.readouterr()

    assert "\\x1b[2J\\x9b.mcap" in told.err
    assert "\\x1b[2J\\x9b.mcap" in told.out
    assert (told.out + told.err).replace("\n", "").isprintable()


def test_a_message_on_standard_error_is_escaped_to_one_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    tell(f"held by {HOSTILE}")

    assert capsys.readouterr().err == (
        "armrig: held by \\x1b]0;mine\\x07\\x1b[2Ja rig \\x9b[red]\\u202e\n"
    )


def test_the_name_of_a_file_is_escaped_next_to_a_spinner() -> None:
    shown = StringIO()
    console = Console(file=shown, force_terminal=True, width=120)

    with spinner("processing", console, after_s=0.0) as count:
        count(1, 2, HOSTILE)
        while "1 of 2" not in shown.getvalue():
            time.sleep(0.01)

    assert SHOWN in shown.getvalue()
    assert HOSTILE[:7] not in shown.getvalue()


def test_brackets_next_to_a_progress_bar_are_not_markup() -> None:
    shown = StringIO()
    console = Console(file=shown, force_terminal=True, width=120)

    with bar("[red]a name", console, note=lambda: "[bold]a note") as progress:
        progress(1, 2)

    assert "[red]a name" in shown.getvalue()
    assert "[bold]a note" in shown.getvalue()
