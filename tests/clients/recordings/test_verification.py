"""`armrig verify`: requirements of a recording, and each violation."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from armrig.data.finding import Finding
from armrig.recordings.files import verification
from armrig.recordings.files.container import Content
from armrig.recordings.files.loading import beginning, load
from armrig.recordings.files.verification import (
    Verification,
    check_input,
    read_input,
    rows,
    verify,
    verify_recording,
)
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.manifest import CONFIG, Outcome
from armrig_core.rig.volts import code_of, device_code, volts_of
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.telemetry import Sample

from tests.clients.made_recordings import gap, manifest, recorded, sample, written

N = 400
U = np.round(np.random.default_rng(1).uniform(0.5, 4.5, N), 3)


def run(**changes: Any) -> list[Sample]:
    """Return the samples of a run that applied U, each as a device of 10 bits does."""
    codes = [code_of(volts) for volts in U.tolist()]
    return [
        sample(
            k,
            u_cmd_v=volts_of(code),
            u_applied_v=volts_of(device_code(code, 10)),
            **changes,
        )
        for k, code in enumerate(codes)
    ]


def clock(k: int, offset_ns: int, **changes: float) -> Any:
    """Return a comparison of the clocks at sample k, certain to 1 µs."""
    certain = {"offset_std_ns": 1e3, "drift_ppm": 0.0, "drift_std_ppm": 0.1, "bound_ns": 0.0}
    certain |= changes
    return protobuf.message_class(protobuf.CLOCK)(
        t_host_ns=sample(k).t_host_ns, offset_ns=offset_ns, **certain
    )


def verified(
    directory: Path,
    messages: Sequence[Any],
    *,
    came: int = N,
    missing: int = 0,
    u: Sequence[float] | None = U.tolist(),
    cut: int = 0,
    outcome: str = "complete",
    **about: Any,
) -> Verification:
    ended = Outcome(outcome=outcome, samples=came, missing=missing)
    of = manifest(k_first=0, samples=N, **about)
    data = recorded(messages, manifest=of, outcome=ended, u=u)
    return verify(written(directory, data[: len(data) - cut]))


def failed(found: Verification) -> dict[str, str]:
    return {c.about: c.text for c in found.checks if c.level == "unusable"}


def test_a_run_that_matches_its_request_passes(tmp_path: Path) -> None:
    found = verified(tmp_path, [*run(), clock(100, 50), clock(200, 70)])

    assert found.passed
    assert failed(found) == {}
    assert [c.about for c in found.checks if c.level == "warning"] == ["configuration"]
    assert found.sha256 == hashlib.sha256((tmp_path / "run.mcap").read_bytes()).hexdigest()
    assert len(repr(found).splitlines()) == len(found.checks)


def test_reported_gaps_may_overlap(tmp_path: Path) -> None:
    messages: list[Any] = run()
    del messages[100:110], messages[:5]
    told = [gap(0, 5, 1.0), gap(103, 7, 1.0), gap(100, 5, 1.0), gap(101, 2, 1.0)]
    beyond = gap(N, 1, 1.0)
    beyond.count = 2**64 - 1 - N

    whole = verified(tmp_path, [*told, *messages, beyond], came=N - 15, missing=15)
    assert "samples" not in failed(whole)
    short = verified(tmp_path, [told[0], *told[2:], *messages], came=N - 15, missing=15)
    assert failed(short)["samples"] == ("5 samples are missing without a gap record, from k=105 on")


def test_checks_are_skipped_without_samples(tmp_path: Path) -> None:
    found = verified(tmp_path, [], came=0, outcome="stopped")

    assert [c.about for c in found.checks if c.level == "good"] == ["file", "attachments"]
    assert dict(rows(found))["verdict"].startswith("passed; not checked: samples, envelope, input")


@pytest.mark.parametrize(("experiment", "may"), [("remote", True), ("blackbox", False)])
def test_only_a_remote_recorder_may_lack_a_voltage(
    tmp_path: Path, experiment: str, may: bool
) -> None:
    """The daemon knows the voltage that it held."""
    of: Any = {"experiment": experiment, "came": N - 19, "missing": 19, "u": None}
    messages: list[Any] = run()
    messages[100:110] = [gap(100, 10, float("nan"))]
    messages[-10:] = [gap(N - 10, 9, 6.0), messages[-1]]
    outside = verified(tmp_path, messages, **of)
    messages[-2] = gap(N - 10, 9, 5.0)
    inside = verified(tmp_path, messages, **of)

    assert ("6 V was held" in failed(outside)["envelope"]) == may
    assert inside.passed == may
    if may:
        [text] = [c.text for c in inside.checks if c.about == "envelope"]
        assert text.endswith("unknown in 1 gap that the recorder missed")


def test_a_run_without_an_attached_input_passes(tmp_path: Path) -> None:
    without = verified(tmp_path, run(), u=None)
    assert without.passed
    assert [c.level for c in without.checks if c.about == "input"] == ["warning"]


def test_a_file_that_is_cut_off_fails_and_can_still_be_loaded(tmp_path: Path) -> None:
    found = verified(tmp_path, run(), cut=30)

    assert "cut off" in failed(found)["file"]
    assert load(tmp_path / "run.mcap").N > 0


@pytest.mark.parametrize(
    ("before", "after", "may"),
    [
        ({"bound_ns": 49e3}, {}, True),
        ({}, {"bound_ns": 49e3}, True),
        ({"bound_ns": 19e3}, {"bound_ns": 19e3}, False),
        ({"bound_ns": 24e3}, {"bound_ns": 24e3}, True),
        ({"drift_ppm": 50.0}, {}, True),  # over 1 s
        ({"drift_ppm": -50.0}, {}, False),
        ({"offset_std_ns": 8.5e3}, {}, True),
        ({"offset_std_ns": 7.5e3}, {}, False),
        ({}, {"offset_std_ns": 8.5e3}, True),
        ({"drift_std_ppm": 8.5}, {}, True),
        ({}, {"drift_std_ppm": 8.5}, False),  # what it may gain from there on
    ],
)
def test_clocks_may_differ_by_the_uncertainty_of_their_comparison(
    tmp_path: Path, before: dict[str, float], after: dict[str, float], may: bool
) -> None:
    """50 µs in 1 s: both bounds, the reported drift, and six deviations of offset and drift."""
    compared = [clock(100, 0, **before), clock(200, 50_000, **after)]

    found = verified(tmp_path, [*run()[:100], compared[0], *run()[100:], compared[1]])

    assert ("clock" not in failed(found)) == may


@pytest.mark.parametrize(
    ("n", "gained_us", "may"),
    [
        (11, 20_500, True),  # of 100 ms: two samples of 10 ms, and 0.6 ms
        (11, 20_700, False),
        (N, 43_900, True),  # of 3990 ms: two samples, and 23.94 ms
        (N, 44_000, False),
    ],
)
def test_a_clock_may_differ_by_its_resonator_tolerance_and_two_samples(
    tmp_path: Path, n: int, gained_us: int, may: bool
) -> None:
    """A short run cannot determine the resonator's error."""
    samples = run()[:n]
    samples[-1] = samples[-1]._replace(t_device_us=samples[-1].t_device_us + gained_us)

    found = verified(tmp_path, samples, came=n, outcome="stopped", u=None)

    assert ("clock" not in failed(found)) == may


def test_each_sample_is_compared_with_the_voltage_of_its_number(tmp_path: Path) -> None:
    messages: list[Any] = run()
    messages[0:3] = [gap(0, 3, 0.0)]
    verified(tmp_path, messages, came=N - 3, missing=3, u=None)
    rec = load(tmp_path / "run.mcap")

    assert check_input(rec, U).level == "good"
    assert check_input(rec, np.roll(U, 1)).level == "unusable"


def test_the_samples_of_an_older_recording_are_numbered_from_the_first_voltage(
    tmp_path: Path,
) -> None:
    """Its manifest has no number of the first sample."""
    rec = load(written(tmp_path, recorded(run()[3:], manifest=manifest(samples=N))))

    assert (rec.manifest.k_first, rec.k_first) == (-1, 3)
    assert check_input(rec, U).level == "good"


def test_an_attached_input_is_a_list_of_as_many_voltages_as_the_run_has_samples(
    tmp_path: Path,
) -> None:
    about = manifest(k_first=0, samples=6)

    def read(u: Sequence[Any]) -> list[float]:
        path = written(tmp_path, recorded([], manifest=about, outcome=None, u=u))
        place = beginning(path)[1].input
        assert place is not None
        return read_input(path, place, 6).tolist()

    assert read(U[:6].tolist()) == U[:6].tolist()
    assert read([1, 2.5e-3]) == [1.0, 0.0025]
    assert read([]) == []
    with pytest.raises(DamageError, match="is longer than the 6 samples of the run"):
        read(U[:7].tolist())
    with pytest.raises(DamageError, match="is longer than the 6 samples of the run"):
        read(U[:200].tolist())
    with pytest.raises(DamageError, match="is not a list of voltages"):
        read([1.0, "one"])


LOWEST, HIGHEST = (volts_of(code_of(float(u))) for u in (U.min(), U.max()))
CODE_V = 5 / 65535


@pytest.mark.parametrize(
    ("low", "high", "level"),
    [
        (0.0, 5.0, "good"),
        (LOWEST, HIGHEST, "good"),
        (LOWEST + 0.4 * CODE_V, HIGHEST - 0.4 * CODE_V, "good"),
        (LOWEST + 0.6 * CODE_V, HIGHEST, "unusable"),
        (LOWEST, HIGHEST - 0.6 * CODE_V, "unusable"),
    ],
)
def test_requested_voltages_are_in_the_limits_of_the_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, low: float, high: float, level: str
) -> None:
    """A limit may lie half a step of the wire's code inside."""
    text = msgspec.json.encode({"limits": {"u_min_v": low, "u_max_v": high}})
    rec = load(written(tmp_path, recorded(run())))

    def checked(attached: bytes) -> Finding:
        content = Content(attachments={CONFIG: attached})
        monkeypatch.setattr(verification, "beginning", lambda path: (path, content))
        [check] = [c for c in verify_recording(rec).checks if c.about == "configuration"]
        return check

    assert checked(text).level == level
    if level == "unusable":
        assert checked(text).text == (
            f"{LOWEST:.4g} to {HIGHEST:.4g} V were requested, "
            f"outside the limits {low:g} to {high:g} V"
        )
