"""The recordings that a line `next:` names: the given recordings, and others of the same origin.

Each folder is drawn: two rigs, two calibrations, one of them also read from another path, and names
and run ids that occur more than once. The virtual daemon makes the recordings.
"""

from __future__ import annotations

from itertools import pairwise, product
from pathlib import Path
from random import Random

import armrig
import pytest
from armrig.cli import main
from armrig.cli.next_step import chassis, counterpart, next_line
from armrig.recordings.files.origin import Origin
from armrig.recordings.files.recording_names import path_of_name
from armrig.recordings.files.recording_summary import (
    VALIDATION_OF,
    RecordingSummary,
    summary_of,
)
from armrig.recordings.usability import all_doubts
from armrig_core.commands.commands import RunRequest
from armrig_core.rig.calibration import Calibration, Made, Potentiometer
from armrig_daemon import config
from armrig_daemon.service.virtual_service import LEASE, VirtualService
from msgspec.structs import replace

FOLDERS = range(4)
MADE = Made(date="1999-12-31T00:00:00+00:00", rig="1", device_uid="0001", armrig="0.2.0")
MEASURED = Calibration(theta_1=Potentiometer(zero_counts=7.0), made=MADE)
MOVED = replace(MEASURED, made=replace(MADE, file="elsewhere.toml"))
"""The same calibration, which the daemon read from another path."""
KINDS = ("step", "blackbox", "greybox")


def record(
    folder: Path, draw: Random, rig: str, calibration: Calibration, seed: int
) -> list[RecordingSummary]:
    """Record some kinds of experiments of half a second; `blackbox` with its validation."""
    settings = config.Config(rig=config.RigIdentity(id=rig), calibration=calibration)
    service, made = VirtualService(settings, folder, seed=seed), list[RecordingSummary]()
    for kind in draw.sample(KINDS, draw.randint(1, 3)):
        name = draw.choice(["", "-first", "-monday"])
        of: dict[str, str] = {}
        for part in ["", "-validation"][: 1 + (kind == "blackbox")]:
            u = [0.5] * 10 + [4.0 if part else 4.5] * 40
            run = RunRequest(lease=LEASE, n=1, u=u, experiment=f"{kind}{part}{name}", details=of)
            made.append(summary_of(service.record(run)))
            of = {VALIDATION_OF: made[-1].run_id}
    return made


@pytest.fixture(scope="module", params=FOLDERS)
def drawn(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> list[RecordingSummary]:
    """Give a folder of recordings; the runs of two rigs have the same ids."""
    folder, draw = tmp_path_factory.mktemp("drawn"), Random(request.param)
    origins = [*enumerate((MEASURED, Calibration(), MOVED))]
    draw.shuffle(origins)
    return [
        s
        for (seed, calibration), rig in product(origins, ["1", "2"])
        for s in record(folder, draw, rig, calibration, seed)
    ]


@pytest.fixture
def folder(
    drawn: list[RecordingSummary], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> list[RecordingSummary]:
    """Make the drawn folder the recording folder, and give its recordings."""
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", str(drawn[0].folder))
    monkeypatch.chdir(tmp_path)
    return drawn


def handout(given: list[Path], capsys: pytest.CaptureFixture[str]) -> list[Path]:
    """Return the recordings of the report that is proposed after a report on the given ones."""
    Path("reasons.toml").unlink(missing_ok=True)
    assert main(["report", *map(str, given), "--questions", "reasons.toml"]) == 0
    words = capsys.readouterr().err.splitlines()[-1].partition("--handout ")[2].split()
    return [path_of_name(word) for word in words[: words.index("--answers")]]


def assert_one_origin(paths: list[Path]) -> None:
    """Assert that armrig itself has no doubt that the recordings are of one rig and calibration."""
    doubts = all_doubts([armrig.load(path) for path in paths], one_plant=False)
    assert not {f.about for f in doubts} & {"rig", "calibrations"}
    assert len({summary_of(path).rig for path in paths}) <= 1


def test_the_report_contains_the_given_recordings_and_only_others_of_their_origin(
    folder: list[RecordingSummary], capsys: pytest.CaptureFixture[str]
) -> None:
    for s in folder:
        paths = handout([s.path], capsys)

        assert s.path in paths
        assert len(set(paths)) == len(paths)
        assert_one_origin(paths)
        kinds = [summary_of(path).kind for path in paths]
        assert kinds == sorted(kinds, key=KINDS.index)  # step, pair, chassis
        assert {kind: kinds.count(kind) for kind in kinds}.items() <= {
            ("step", 1),
            ("blackbox", 2),
            ("greybox", 1),
        }


def test_the_report_completes_a_given_pair(
    folder: list[RecordingSummary], capsys: pytest.CaptureFixture[str]
) -> None:
    pairs = [(a, b) for a, b in pairwise(folder) if b.is_validation]

    for a, b in pairs:
        paths = handout([a.path, b.path], capsys)

        excited = [path for path in paths if summary_of(path).kind == "blackbox"]
        assert excited == [a.path, b.path]
        assert_one_origin(paths)


def test_the_report_keeps_recordings_of_two_rigs_and_adds_none(
    folder: list[RecordingSummary], capsys: pytest.CaptureFixture[str]
) -> None:
    two = [next(s.path for s in folder if s.rig == rig) for rig in ("1", "2")]

    assert sorted(handout(two, capsys)) == sorted(two)


def test_the_report_without_given_recordings_is_of_one_origin(
    folder: list[RecordingSummary], capsys: pytest.CaptureFixture[str]
) -> None:
    paths = handout([], capsys)

    assert paths
    assert_one_origin(paths)


def test_each_later_command_stays_with_the_origin_of_the_recording(
    folder: list[RecordingSummary],
) -> None:
    for s in folder:
        origin = Origin.of_summary(s)
        experiment = {"Ts": s.Ts, "seconds": 30, "switching": ""}
        lines = [
            next_line("collect pair", origin, **experiment),
            next_line("collect step", origin),
            next_line("collect step again", origin, again=" --name first"),
            next_line("collect greybox", origin),
        ]

        names = [word for line in lines for word in line.split() if word.startswith("@")]
        others = [counterpart(s.path, "estimation"), counterpart(s.path, "validation")]
        for name in filter(None, [*names, *others, chassis(origin)]):
            assert_one_origin([s.path, path_of_name(name)])
        # A command that records names the rig of the recording.
        records = [line.split() for line in lines if " collect " in line]
        assert all(("--rig" in words) == (s.rig != "1") for words in records)


def test_the_validation_of_a_recording_is_of_the_same_rig_although_its_id_occurs_twice(
    folder: list[RecordingSummary],
) -> None:
    for a, b in pairwise(folder):
        if b.is_validation:
            assert path_of_name(counterpart(a.path, "validation")) == b.path
            assert path_of_name(counterpart(b.path, "estimation")) == a.path
