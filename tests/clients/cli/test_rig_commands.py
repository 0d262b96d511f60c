"""`armrig status`, `watch`, `stop`, `reset` and `note` of a rig that is not there."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest
from armrig.cli import main, runs
from armrig.cli.rig import DecisionNote, _heading, _sample_line
from armrig.rig.replies import RefusedError
from armrig.rig.telemetry_stream import LiveGap
from armrig_core.commands.codes import COMPLETE, RefusalCode
from armrig_core.commands.commands import StatusReport
from armrig_core.rig.description import builtin
from armrig_protocol.messages import Flag

from tests.clients.fake_daemon import status_report
from tests.clients.made_recordings import sample
from tests.clients.told import told

FAR = "tcp/far:7447"
GAP = LiveGap(
    **{"k_first": 43, "count": 2, "t_from_ns": 1, "t_to_ns": 3, "u_held_v": 0.0, "code": "unknown"},
    **{"reason": "link silent", "published": True},
)


class _Rig:
    """Takes requests; `asked` has their arguments."""

    asked: list[Any]
    refused: RefusedError | None = None
    report: dict[str, Any]
    done = True

    def __init__(self, rig: str, *, connect: str | None) -> None:
        self.asked.append((rig, connect))

    def __enter__(self) -> _Rig:
        return self

    def __exit__(self, *_: object) -> None:
        self.asked.append("closed")

    def status(self) -> StatusReport:
        return status_report(**self.report)

    def stream(self, name: str) -> Iterator[Any]:
        self.asked.append(name)
        return iter([sample(42), GAP, sample(45), sample(46)])

    def arrivals(self, name: str) -> Any:
        assert name == "control"
        return nullcontext(lambda: [])

    def _do(self, *words: str) -> bool:
        if self.refused is not None:
            raise self.refused
        self.asked.append(words)
        return self.done

    def stop(self, by: str) -> None:
        self._do("stop", by)

    def reset(self) -> bool:
        return self._do("reset")

    def note(self, text: str, owner: str) -> bool:
        return self._do("note", text, owner)


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> type[_Rig]:
    """Give the rig that commands open."""
    made = type("Opened", (_Rig,), {"asked": [], "report": {}})
    monkeypatch.setattr("armrig.Rig", made)
    monkeypatch.setattr("armrig.cli.next_step._goes_on", lambda line, _: line)
    return made


@pytest.mark.parametrize(
    ("phases", "said"), [(("active", "active", "safe"), "at 0 V"), (("active",) * 9, "driven")]
)
def test_a_stop_reports_the_motor_after_the_end_of_the_input(
    phases: tuple[str, ...],
    said: str,
    rig: type[_Rig],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    now_s, left = [0.0], list(phases)

    def waited(seconds: float) -> None:
        now_s[0] += 0.2
        left.pop(0)

    def status(self: _Rig) -> StatusReport:
        motor = "at 0 V" if left[0] == "safe" else "driven"
        self.report.update(phase=left[0], motor=motor)
        return of_the_rig(self)

    of_the_rig = rig.status
    rig.status = status  # type: ignore[method-assign]
    for name, fake in (("sleep", waited), ("monotonic", lambda: now_s[0])):
        monkeypatch.setattr(f"time.{name}", fake)

    assert main(["stop"]) == 0

    assert capsys.readouterr().out == f"rig 1, motor: {said}\n"


@pytest.mark.parametrize(
    ("words", "asked", "said", "facts"),
    [
        (["stop"], ("stop", ""), "rig 7, motor: stop sent", {"stopped": True}),
        (["stop", "--owner", "Ada"], ("stop", "Ada"), "rig 7, motor: stop sent", {"stopped": True}),
        (["reset"], ("reset",), "rig 7 was reset", {"was_latched": True}),
        (
            ["note", "touched", "--owner", "Ada"],
            ("note", "touched", "Ada"),
            "rig 7: the note is in the recording",
            {"recorded": True},
        ),
    ],
)
def test_a_command_sends_its_request_to_its_rig_and_disconnects(
    words: list[str],
    asked: tuple[str, ...],
    said: str,
    facts: dict[str, Any],
    rig: type[_Rig],
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = [*words, "--rig", "7", "--connect", FAR]

    assert main(given) == 0
    text = capsys.readouterr()
    assert main([*given, "--json"]) == 0

    assert rig.asked == [("7", FAR), asked, "closed"] * 2
    assert text.out == f"{said}\n"
    goes_on = "" if words[0] != "reset" else f"next: armrig status --rig 7 --connect {FAR}\n"
    assert text.err == goes_on
    assert json.loads(capsys.readouterr().out) == {"rig": "7", **facts}


def test_a_request_without_effect_is_reported_as_such(
    rig: type[_Rig], capsys: pytest.CaptureFixture[str]
) -> None:
    rig.done = False

    assert main(["reset"]) == main(["note", "touched"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert main(["reset", "--json"]) == main(["note", "touched", "--json"]) == 0

    assert said == [
        "rig 1: no fault is latched",
        "rig 1: no run is being recorded, so the note is not in a recording",
    ]
    facts = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert facts == [{"rig": "1", "was_latched": False}, {"rig": "1", "recorded": False}]
    assert rig.asked[0] == ("1", None)


def test_a_refusal_names_the_command_that_resets_this_rig(
    rig: type[_Rig], capsys: pytest.CaptureFixture[str]
) -> None:
    rig.refused = RefusedError("in fault", RefusalCode.IN_FAULT, {"reason": "link lost"})

    assert main(["note", "touched", "--rig", "7", "--connect", FAR]) == 1

    way_out = f"in fault (link lost): repair it, then `armrig reset --rig 7 --connect {FAR}`"
    assert way_out in told(capsys).replace("\n", " ")


@pytest.mark.parametrize(
    ("report", "goes_on"),
    [
        ({}, "collect step --rig 7 --Ts 0.002"),
        ({"arm_removed": True}, "collect greybox --rig 7 --Ts 0.01"),
        ({"line": "no device answers"}, ""),
        ({"phase": "run"}, ""),
        ({"phase": "fault", "reason": "link lost"}, ""),
    ],
)
def test_the_status_of_a_ready_rig_suggests_its_first_recording(
    report: dict[str, Any],
    goes_on: str,
    rig: type[_Rig],
    capsys: pytest.CaptureFixture[str],
) -> None:
    rig.report = report

    assert main(["status", "--rig", "7"]) == 0
    said = capsys.readouterr()
    assert main(["status", "--rig", "7", "--json"]) == 0

    assert said.err.startswith(f"next: armrig {goes_on}") if goes_on else not said.err
    facts = json.loads(capsys.readouterr().out)
    assert (facts["rig"], facts["phase"]) == ("7", report.get("phase", "safe"))


def test_a_line_of_watch_has_its_units() -> None:
    volts = {"u_applied_v": 1.25, "u_cmd_v": 3.0}
    one = sample(42)._replace(**volts, value_0=-1.0, value_1=0.5, t_host_ns=0)

    channels = builtin("arm").channels
    line = _sample_line(one._replace(t_sched_ns=-7_500), channels)

    assert line.split() == ["42", "1.250", "-57.30", "28.65", "7.5"]
    assert len(line) == len(_heading(channels))


def test_a_sample_of_a_run_in_control_has_its_reference_and_the_share_at_a_limit() -> None:
    """A decision comes before its sample; the next run begins without those of the last one."""

    def decision(k: int, *, is_high: bool = False) -> Any:
        bits = {"is_low": False, "is_high": is_high, "is_slewed": False, "predicted": 0}
        return SimpleNamespace(k=k, r=k / 8, **bits)

    come = [[decision(0), decision(1, is_high=True)], [decision(2)], [], [], [decision(4)]]
    note = DecisionNote(lambda: come.pop(0))
    runs = [Flag.RUN, Flag.RUN, Flag.RUN, Flag(0), Flag.RUN, Flag.RUN]
    come.append([])

    said = [note.of(sample(k)._replace(flags=int(flags))) for k, flags in enumerate(runs)]

    assert said == [
        " r 0, at its limit in 0 %",
        " r 0.125, at its limit in 50 %",
        " r 0.25, at its limit in 33.3 %",
        "",
        " r 0.5, at its limit in 0 %",
        " r 0.5, at its limit in 0 %",
    ]


def test_watch_prints_samples_and_gaps_as_lines_or_json(
    rig: type[_Rig], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["watch", "--count", "3"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert main(["watch", "--json"]) == 0
    facts = [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    assert [line.split()[0] for line in lines] == ["k", "42", "43", "45"]
    assert lines[2].split()[1:] == ["2", "missing:", "link", "silent"]
    assert [x.get("k", x.get("k_first")) for x in facts] == [42, 43, 45, 46]
    assert (facts[1]["count"], facts[1]["reason"]) == (2, "link silent")
    assert facts[0]["u_applied_v"] == sample(42).u_applied_v


@pytest.mark.parametrize("error", [None, OSError("disk full"), RuntimeError("lost")])
def test_a_remote_recording_reports_the_reason_of_its_end(
    error: Exception | None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ended: list[Any] = []
    files = [SimpleNamespace(path="a.mcap", samples=1, missing=0, outcome="o")]

    def recorder(_: Any, __: Any) -> Any:
        def recorded(*asked: Any) -> None:
            ended.append(asked[1])
            if error:
                raise error

        return SimpleNamespace(begin=lambda: True, record=recorded)

    recording = SimpleNamespace(done=files, finish=ended.append)
    connection = SimpleNamespace(session=nullcontext(), endpoint="E")
    fakes: dict[str, Any] = {
        "rig.remote_recording.RemoteRecorder": recorder,
        "rig.remote_recording.RemoteRecording": lambda **_: recording,
        "cli.runs.command_line_name": str,
        "rig.session.open_connection": lambda *_, **__: connection,
    }
    for name, fake in fakes.items():
        monkeypatch.setattr(f"armrig.{name}", fake)
    stopped: Any = SimpleNamespace(is_set=lambda: False)

    def run() -> None:
        runs._record_one(runs._Remote(source="E", rigs=["7"], seconds=2.5), stopped)

    if error is None:
        run()
    else:
        with pytest.raises(type(error), match=str(error)):
            run()

    assert ended[0] == 2.5
    assert (ended[1] is COMPLETE) == (error is None)
    assert error is None or ended[1].text == f"the recorder ended: {error}"
    said = capsys.readouterr().err
    assert "recording rig 7 from E; Ctrl-C ends it" in said
    assert ("recorded up to the error: a.mcap" in said) == (error is not None)
