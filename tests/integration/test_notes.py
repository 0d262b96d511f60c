"""Notes on real processes: written while a run is recorded, and nothing to the run."""

from __future__ import annotations

import json
import time
from typing import Any

import armrig
import pytest
from armrig.cli import main
from armrig_core import commands

from tests.integration.driving import check_volts
from tests.integration.processes import Bench, wait_for
from tests.integration.watching import endpoint

HOSTILE = "#panic() <img src=x onerror=alert(1)> `ls` $(ls) *x* \U0001f916"
FLOOD = 400


def test_notes_are_in_the_recording_and_nothing_to_the_run(
    served: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    """S5, R1: notes of the command line, with markup, refused ones and a flood."""
    where = ["--connect", endpoint(served)]
    with served.rig() as rig:
        rig.arm("a test", Ts=0.01)
        u = [1.0, 2.0] * 15_000
        run = rig._ask(commands.Run(**rig._stamp(), u=u), commands.RunAccepted)
        wait_for(lambda: (last := rig.status().last_run) is not None and last.samples > 10)

        began_s = time.monotonic()
        assert main(["note", HOSTILE, *where, "--owner", "Ada (certificate root)"]) == 0
        assert [_sent(rig, **note) for note in _REFUSED] == [""] * len(_REFUSED)
        taken = sum(_sent(rig, text=f"{i}") == '{"done":true}' for i in range(FLOOD))
        most = 20 + 2 * (time.monotonic() - began_s)
        assert rig.status().phase == "active"
        rig.stop("a test")
        wait_for(lambda: (last := rig.status().last_run) is not None and last.finished)

    assert capsys.readouterr().out == "rig 1: the note is in the recording\n"
    recording = armrig.load(run.recording)
    assert recording.outcome is not None
    assert recording.outcome.outcome == "stopped by a test"
    first, *flood = recording.notes
    assert (first.text, first.owner) == (HOSTILE, "Ada [certificate root]")
    assert 0 < first.t < recording.t[-1]
    assert len(flood) == taken <= most
    assert {note.owner for note in flood} == {"somebody on this machine"}
    assert [int(note.text) for note in flood] == sorted(int(note.text) for note in flood)
    assert not [e for e in recording.events if "panic" in e.message]
    check_volts(served, 1.0, 2.0)


_REFUSED: list[dict[str, Any]] = [
    {"text": "x" * 10_000},
    {"text": "x" * 501},
    {"text": "\x1b[2J"},
    {"text": "a\nb"},
    {"text": ""},
    {"text": 7},
    {"text": "x", "lease": "0" * 32},
    {},
]


def _sent(rig: armrig.Rig, **fields: Any) -> str:
    """Send a note unchecked; return the answer, "" for a refusal."""
    key = f"rig/{rig.rig}/cmd/note"
    (reply,) = rig._connected().get(key, payload=json.dumps(fields), timeout=30)
    return "" if reply.ok is None else reply.ok.payload.to_bytes().decode()
