"""Results of other rooms, as commands print them for a person and in JSON."""

from __future__ import annotations

import json
import os
import signal
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import armrig
import pytest
from armrig import __main__ as program
from armrig.cli import demo, main
from armrig.data.finding import warning
from armrig.excitation.demonstration import experiments
from armrig.excitation.pace import Pace
from armrig.lab.fleet_recorder import RigRecorded
from armrig.report.batch.tasks import CHECKS
from armrig_daemon.config import load

from tests.clients.made_recordings import manifest, of_the_arm, recorded, sample, written


def _row(name: str, **of: Any) -> dict[str, Any]:
    return {"recording": name, "problem": "", "damage": "", **of}


UNDAMAGED = "the result covers the undamaged part"


def _checked(name: str, failed: str, **of: Any) -> dict[str, Any]:
    """Return the row of `batch verify` for a recording that fails one check."""
    checks = {f"{check}_result": "failed" if check == failed else "passed" for check in CHECKS}
    found = {f"{check}_found": f"found of {check}" for check in CHECKS}
    return _row(name, passed=not failed, **checks, **found, **of)


@pytest.mark.parametrize(
    ("rows", "code", "head", "facts"),
    [
        ([_row("a"), _row("b")], 0, "2 recordings; 0 without a result", {}),
        (
            [_row("a", problem="no input"), _row("b", damage="cut")],
            1,
            "2 recordings; 1 without a result",
            {"problems": {"a": "no input"}, "damaged": {"b": f"{UNDAMAGED}: cut"}},
        ),
        (
            [_checked("a", "clock", damage="cut"), _checked("b", ""), _row("c", damage="cut")],
            1,
            "3 recordings; 0 without a result",
            {
                "failed": {"a": "clock failed: found of clock"},
                "damaged": {"c": f"{UNDAMAGED}: cut"},
            },
        ),
        (
            [_row(name, problem="why", damage="cut") for name in "abc"],
            1,
            "3 recordings; 3 without a result",
            {"problems": dict.fromkeys("abc", "why")},
        ),
        (
            [_row(name, problem="why") for name in "abcde"],
            1,
            "5 recordings, 2 of them processed before; 5 without a result",
            {"problems": dict.fromkeys("abcde", "why"), "done_before": 2},
        ),
    ],
    ids=["good", "problem", "failed", "three", "five"],
)
def test_a_batch_reports_missing_results_damage_and_failed_checks(
    rows: list[dict[str, Any]],
    code: int,
    head: str,
    facts: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    done = rows, facts.get("done_before", 0)
    monkeypatch.setattr("armrig.report.batch.batch.batch", lambda *_, **__: done)

    assert main(["batch", "verify", ".", "-o", "t.parquet"]) == code
    text = capsys.readouterr()
    assert main(["batch", "verify", ".", "-o", "t.parquet", "--json"]) == code

    first, *lines = text.out.splitlines()
    assert first == f"t.parquet: {head}"
    problems, damaged, failed = (facts.get(x, {}) for x in ("problems", "damaged", "failed"))
    found = [f"  {name}: {why}" for x in (problems, damaged, failed) for name, why in x.items()]
    more = "  and 2 more; the column problem contains all reasons"
    assert lines == (found if len(found) < 5 else [*found[:3], more])
    how = f"{len(failed)} failed a check: {', '.join(failed)}; the table contains the checks"
    assert text.err == (f"armrig: {how}\n" if failed else "")
    empty: dict[str, Any] = {"problems": {}, "damaged": {}, "failed": {}}
    assert json.loads(capsys.readouterr().out) == {
        **{"table": "t.parquet", "rows": len(rows), "done_before": 0},
        **(empty | facts),
    }


def test_a_fleet_reports_each_file_and_each_failed_or_silent_rig(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = SimpleNamespace(path=Path("a.mcap"), samples=20, missing=3, outcome="complete")
    of: dict[str, RigRecorded] = {
        "7": RigRecorded(rig="7", files=[file]),
        "8": RigRecorded(rig="8", files=[]),
        "9": RigRecorded(rig="9", files=[], why="disk full"),
    }
    paths: list[Path] = []

    class Recorder:
        def __init__(self, _: Any, where: str, path_of: Any, *__: Any) -> None:
            paths.append(path_of("7"))

        def record(self, ended: Any, seconds: float, rigs: list[str] | None) -> list[RigRecorded]:
            return [of[rig] for rig in rigs or ["7", "8"]]

    opened = SimpleNamespace(session=nullcontext(object()))
    fakes: dict[str, Any] = {"armrig.lab.fleet_recorder.FleetRecorder": Recorder}
    fakes |= {"armrig.rig.session.open_endpoint": lambda _: opened, "time.strftime": lambda _: "T"}
    for name, fake in fakes.items():
        monkeypatch.setattr(name, fake)
    out = tmp_path / "of" / "monday"

    def recorded_of(*words: str) -> tuple[int, str, str]:
        code = main(["record", "--from", "tcp/a:1", "-o", str(out), *words])
        return code, *capsys.readouterr()

    both = recorded_of("--rig", "7", "--rig", "8")
    every = recorded_of("--all", "--json")
    early = recorded_of("--rig", "7", "--rig", "9", "--json")
    none = recorded_of("--rig", "8", "--rig", "8")

    assert both[:2] == (1, "a.mcap: 20 samples, 3 missing, complete\n")
    assert "recording rigs 7, 8 from tcp/a:1; Ctrl-C ends it" in both[2]
    assert "rig 8: no sample arrived, so it has no recording" in both[2]
    recordings = [
        {"rig": "7", "recording": "a.mcap", "samples": 20, "missing": 3, "outcome": "complete"}
    ]
    assert (every[0], json.loads(every[1])) == (0, {"recordings": recordings, "failed": []})
    assert "recording all rigs from tcp/a:1" in every[2]
    assert json.loads(early[1])["failed"] == [{"rig": "9", "why": "disk full"}]
    assert (early[0], "ended early for rig 9, of 2 rigs; see above" in early[2]) == (1, True)
    assert (none[0], "no rig at tcp/a:1 published a sample" in none[2]) == (1, True)
    assert paths == [out / "7-remote-T.mcap"] * 4
    assert out.is_dir()


HINTS: dict[str, Any] = {
    **dict.fromkeys(("structures", "resonances", "antiresonances", "nk_interval"), ()),
    "reasons": ("the first", "the second"),
    **dict.fromkeys(("low_slope", "high_slope"), 0.0),
    **{"process": "", "nb": 3, "nf": 5, "nk": 2, "integrator_shown": True, "relative_degree": 4},
}


class _Hints(SimpleNamespace):
    def explain(self) -> str:
        return "- the first\n- the second"

    def __repr__(self) -> str:
        return "hints of a test"


@pytest.mark.parametrize(
    ("integrator", "doubtful", "given"),
    [
        (True, "", ""),
        (False, "", " --signal alpha --from 0.5"),
        (True, "feedback", " --from 0.5"),
        (False, "", ""),
    ],
)
def test_the_command_after_the_hints_has_their_structure_and_orders(
    integrator: bool,
    doubtful: str,
    given: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    doubts = [warning(doubtful, "a doubt", "check")] if doubtful else []
    family = "bj" if doubts else "oe"
    named = {"family": family, "integrator": integrator, "findings": doubts, "doubts": doubts}
    found = _Hints(**HINTS, **named, excess={4: 3.5, 5: 0.0})
    monkeypatch.setattr("armrig.structure_hints", lambda _, integrator: found)
    path = written(tmp_path, of_the_arm(armrig.telegraph(200, 0.1, seed=1)))
    typed = ["hints", str(path), *given.split()]

    assert main(typed) == 0
    said = capsys.readouterr()
    assert main([*typed, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)

    is_doubted = bool(doubtful)
    title, linearity = said.out.splitlines()
    assert title == "hints of a test"
    assert linearity.startswith("  linearity: no nonlinearity found (p = ")
    options = f"--structure {family} --nb 3 --nf 5 --nk 2{' --integrator' * integrator}{given}"
    line = f"next: armrig identify {path} {options} --save model.json"
    assert said.err.splitlines()[-1] == line
    assert facts["structure"] == family
    assert facts["orders"] == {"nb": 3, "nf": 5, "nk": 2}
    assert facts["doubts"] == ["a doubt"] * is_doubted
    assert (facts["recording"], facts["integrator"]) == (armrig.load(path).sha256, integrator)


def test_a_demonstration_plays_a_step_and_two_telegraphs_with_seeds_in_a_row() -> None:
    for seconds, seed in ((5.0, 1), (7.5, 40)):
        step, telegraph, validation = experiments(Pace(seconds=seconds), seed)

        assert [step.name, telegraph.name, validation.name] == ["step", "telegraph", "validation"]
        assert (step.seconds, telegraph.seconds, validation.seconds) == (3.0, seconds, seconds)
        assert step.u.tolist() == [0.5] * 50 + [4.5] * 250
        assert step.request["experiment"] == "step"
        for one, number in ((telegraph, seed), (validation, seed + 1)):
            wanted = armrig.telegraph(one.u.size, 0.05, 0.5, 4.5, seed=number)
            assert one.u.tolist() == wanted.tolist()
            details = {"input": "telegraph", "low": 0.5, "high": 4.5, "a": 0.05, "seed": number}
            assert one.request == {"experiment": "blackbox", "details": details}


def test_a_demonstration_records_into_its_folder(tmp_path: Path) -> None:
    folder = tmp_path / 'a "folder"\\of mine'
    folder.mkdir()

    config = load([demo.write_config(folder, 17, 0.01)], {}, {})

    assert config.recording.directory == str(folder)
    assert (config.emulator.seed, config.timing.Ts, config.rig.id) == (17, 0.01, "demo")


@pytest.mark.parametrize(
    ("virtual", "n_real", "why"), [(True, 0, ""), (False, 3, ""), (False, 1, "too busy")]
)
def test_a_demonstration_completes_missing_recordings_in_virtual_time(
    virtual: bool,
    n_real: int,
    why: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    paths = [tmp_path / f"{i}.mcap" for i in range(3)]
    asked: list[Any] = []

    def in_real_time(_: Any, __: Any, done: list[Path]) -> str:
        done += paths[:n_real]
        return why

    def in_virtual_time(plan: Any, _: Any, __: Any, seed: int, *, firmware: bool) -> list[Path]:
        asked.append(([one.name for one in plan], seed, firmware))
        return paths[n_real:]

    def reported(all_of: list[Path], remarks: list[str], folder: Path) -> Any:
        asked.append((all_of, len(remarks)))
        row = {"name": "oe", "rms_error": 0.5, "fit_percent": 90.0, "velocity_fit_percent": None}
        models = [SimpleNamespace(**row)]
        return SimpleNamespace(models=models), folder / "report.pdf"

    work = {"_record": in_real_time, "record_in_virtual_time": in_virtual_time}
    work |= {"_write_report": reported, "_text": lambda *_: ""}
    for name, function in work.items():
        monkeypatch.setattr(demo, name, function)

    options = ["--seconds", "5", "--seed", "9", "--json", *["--virtual"] * virtual]
    assert main(["demo", "--directory", str(tmp_path / "d"), *options]) == 0

    said = capsys.readouterr()
    found = json.loads(said.out)
    names = ["step", "telegraph", "validation"]
    assert found["recordings"] == dict(zip(names, map(str, paths), strict=True))
    assert found["in_virtual_time"] == names[n_real:]
    errors = {"rms_error": 0.5, "fit_percent": 90.0, "velocity_fit_percent": None}
    assert found["models"] == [{"model": "oe", **errors}]
    assert found["report"] == str(tmp_path / "d" / "report.pdf")
    assert asked[:-1] == ([(names[n_real:], 9, False)] if n_real < 3 else [])
    assert asked[-1] == (paths, 1 if n_real == 3 else 2)
    assert ("not in real time: too busy" in said.err) == bool(why)
    assert ("the daemon's log: " in said.err) is not virtual


def test_a_demonstration_prints_the_results_of_its_models(tmp_path: Path) -> None:
    path = written(tmp_path, recorded([sample(k) for k in range(4)], manifest=manifest()))
    rec = armrig.load(path)
    of = {"oe": (0.5, 90.0, 80.0), "arx": (0.25, 95.125, None)}
    models = [
        SimpleNamespace(name=name, rms_error=rms, fit_percent=fit, velocity_fit_percent=velocity)
        for name, (rms, fit, velocity) in of.items()
    ]
    validation = SimpleNamespace(unit="rad")
    done: Any = SimpleNamespace(models=models, recordings=[rec], validation=validation, of_arm=True)

    said = demo._text(done, ["step"], tmp_path, Path("r.pdf")).splitlines()

    assert [" ".join(line.split()) for line in said] == [
        "simulated on the validation recording",
        "model rms error fit of the angle fit of the velocity",
        "oe 0.5 rad 90.00 % 80.00 %",
        "arx 0.25 rad 95.12 %",
        "",
        f"step {path}: 4 samples, sha256 {rec.short_hash}",
        f"figures {tmp_path}/*.svg",
        "report r.pdf",
    ]


def test_a_second_signal_does_not_disturb_the_end_of_a_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stopped: list[str] = []

    def command(given: list[str]) -> None:
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            signal.raise_signal(signal.SIGHUP)
            stopped.append("the rig")

    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGHUP)
    monkeypatch.setattr("armrig.cli.load", command)

    assert main(["ls"]) == 128 + signal.SIGTERM

    assert stopped == ["the rig"]
    assert capsys.readouterr().err.endswith("armrig: ended by SIGTERM\n")
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGHUP)) == before


def test_ctrl_c_outside_a_command_is_reported_in_a_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted() -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr("armrig.cli.main", interrupted)

    assert program.main() == 130
    assert capsys.readouterr().err == "armrig: interrupted\n"


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (FileNotFoundError(2, "gone", "A.MCAP"), "A.MCAP: gone; `armrig ls` lists the recordings"),
        (FileNotFoundError(2, "gone", "m.json"), "m.json: gone; `armrig identify F --structure oe"),
        (FileNotFoundError(2, "gone", "d.csv"), "d.csv: gone\n"),
        (IsADirectoryError(21, "a folder", "d"), "d: a folder; give a file in the folder\n"),
        (
            PermissionError(13, "no", b"d.mcap"),
            "d.mcap: no; ask its owner, or use a folder of yours",
        ),
        (OSError("the line is gone"), "the line is gone\n"),
    ],
    ids=lambda x: type(x).__name__,
)
def test_an_error_of_the_system_names_the_file_and_what_to_do(
    error: OSError, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def failing(_: Path) -> None:
        raise error

    monkeypatch.setattr("armrig.catalogue", failing)
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", os.devnull)

    assert main(["ls", "--count", "1", "elsewhere"]) == 1

    assert capsys.readouterr().err.startswith(f"armrig: {said}")


def test_a_firmware_larger_than_the_flash_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("armrig.lab.avrdude.FLASH_BYTES", 100)

    assert main(["flash", "--dry-run"]) == 1
    assert "but an ATmega328P has room for 100" in capsys.readouterr().err
