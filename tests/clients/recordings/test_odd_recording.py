"""A recording without any default is read as the rig recorded it."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from math import isnan, nan, tau
from pathlib import Path

import msgspec
import numpy as np
import pytest
from armrig.recordings.channels import turns_unknown
from armrig.recordings.files.loading import load
from armrig.recordings.files.recording_summary import summary_of
from armrig.recordings.files.verification import (
    check_clock,
    check_envelope,
    check_file,
    check_input,
    check_timing,
)
from armrig.recordings.jitter import (
    fastest_rate,
    intervals_us,
    lateness_us,
    sampling_statistics,
)
from armrig.recordings.overview import Overview, overview
from armrig.recordings.recording import Recording, export_columns
from armrig.rig.playback import read_run
from armrig_core.commands.codes import OutcomeCode
from armrig_core.recording_file.manifest import Outcome
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.telemetry import decode_sample

from tests.clients.made_recordings import with_channel
from tests.clients.odd_recording import (
    CLIPPED,
    K_FIRST,
    MISSING,
    ODD,
    SLOW_PPM,
    TS,
    ZERO_NS,
    N,
    angles,
    applied,
    asked,
    due_ns,
    held,
    odd_recording,
)

_Gap = protobuf.message_class(protobuf.GAP)
NOISE = 6 * 17.0
"""Six standard deviations of a reading, in counts: a step of 16, and its rounding."""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("odd") / "seven.mcap"
    path.write_bytes(odd_recording())
    return path


@pytest.fixture(scope="module")
def odd(path: Path) -> Recording:
    return load(path)


def test_each_row_contains_the_phase_at_its_time(odd: Recording) -> None:
    theta_1, alpha = angles()
    unknown = [120, *range(280, 284)]

    whole_turns = (odd.theta_1 - theta_1)[odd.valid] / tau

    assert (odd.k_first, odd.N, odd.missing, odd.asked_s) == (4_000, 518, 21, 30.0)
    np.testing.assert_allclose(odd.t, np.arange(N) * TS)
    np.testing.assert_array_equal(np.flatnonzero(~odd.present), MISSING)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(odd.u)), unknown)
    expected = np.where(held() > 0, 0.9 * held() + 0.2, 0.0)
    np.testing.assert_allclose(odd.u, np.where(np.isnan(odd.u), np.nan, expected))
    turned = np.round(whole_turns)
    np.testing.assert_allclose(whole_turns, turned, atol=NOISE * 9.4e-5 / tau)
    assert set(turned[: np.flatnonzero(odd.valid).searchsorted(200)]) == {0.0}
    np.testing.assert_allclose(
        odd.alpha[odd.valid_alpha], alpha[odd.valid_alpha], atol=NOISE * 1e-4
    )
    clipped = odd.present & ~odd.valid_alpha
    np.testing.assert_array_equal(np.flatnonzero(clipped), CLIPPED)
    assert odd.turns_unknown == (207,)


def test_the_data_are_divided_where_u_or_the_turns_are_unknown(odd: Recording) -> None:
    theta_1, alpha, rate = odd.dataset(), odd.dataset("alpha"), odd.dataset("velocity")
    known = np.flatnonzero(np.isfinite(odd.u))

    begins = [0, *np.searchsorted(known, [121, 207, 284]).tolist()]

    assert list(theta_1.starts) == begins == [0, 120, 206, 279]
    assert list(alpha.starts) == [0, 120, 279]  # the arm does not turn on
    np.testing.assert_array_equal(theta_1.y, odd.theta_1[known])
    np.testing.assert_array_equal(alpha.y, odd.alpha[known])
    np.testing.assert_array_equal(theta_1.u, odd.u[known])
    assert rate.unit == "rad/s"
    speeds = np.diff(odd.theta_1, prepend=np.nan) / TS
    speeds[[121, 207, 284]] = np.nan  # nothing is known across a cut
    np.testing.assert_allclose(rate.y, speeds[known])
    assert fastest_rate(theta_1) == pytest.approx(
        np.nanpercentile(np.abs(np.diff(theta_1.y)) / TS, 99)
    )


def test_sampling_statistics_use_the_clock_of_the_device(odd: Recording) -> None:
    """The device's clock is 80 ppm slow."""
    k = odd.samples["k"].astype(np.int64)
    t_us, late = odd.samples["t_device_us"].astype(np.int64), odd.samples["t_host_ns"]
    adjacent = [t_us[i + 1] - t_us[i] for i in range(k.size - 1) if k[i + 1] == k[i] + 1]

    found = sampling_statistics(odd)

    np.testing.assert_array_equal(intervals_us(odd), adjacent)
    assert len(adjacent) == N - len(MISSING) - 6  # one interval less for each stretch
    assert found.mean_us == pytest.approx(50_000 * (1 - SLOW_PPM * 1e-6), abs=4 * 57 / 491)
    assert found.std_us == pytest.approx(40 * 2**0.5, rel=0.15)
    late_us = (late - odd.samples["t_sched_ns"]) / 1e3
    jitter_us = np.abs(np.array(adjacent) - 50_000.0)
    np.testing.assert_allclose(lateness_us(odd), late_us)
    assert np.count_nonzero(late_us < 0) == 2
    for shown, values in ((found.jitter, jitter_us), (found.lateness, late_us)):
        percentiles = np.percentile(values, (50, 90, 99, 99.9, 100))
        assert shown.n == values.size
        assert [shown.p50, shown.p90, shown.p99, shown.p999, shown.max] == pytest.approx(
            percentiles
        )
    assert (found.least_us, found.greatest_us) == (min(adjacent), max(adjacent))
    assert found.Ts_us == 50_000.0
    assert (found.samples, found.missing, found.longest_gap) == (497, 21, 7)


def test_signals_begin_an_experiment_with_each_output(odd: Recording) -> None:
    alpha, rate, theta_1 = (odd.dataset(name) for name in ("alpha", "velocity", "theta_1"))

    found, of_alpha = odd.signals(["alpha", "velocity"]), odd.signals(["alpha"])

    assert (found.outputs, found.units) == (("alpha", "velocity"), ("rad", "rad/s"))
    assert (found.starts, of_alpha.starts) == (theta_1.starts, alpha.starts)
    np.testing.assert_array_equal(found.y, np.column_stack([alpha.y, rate.y]))
    np.testing.assert_array_equal(found.valid, np.column_stack([alpha.valid, rate.valid]))
    np.testing.assert_array_equal(found.u.ravel(), alpha.u)


def test_a_part_has_the_comparisons_of_the_clocks_of_its_time(path: Path) -> None:
    assert [c.t for c in load(path, start=2.9, stop=14.2).clock] == [5.0]


def test_published_messages_keep_their_order(path: Path) -> None:
    run = read_run(path)
    part = read_run(path, 2.9, 14.2)

    messages, of_part = list(run.messages()), list(part.messages())
    times = [m.t for m in messages]
    samples = [s for m in messages if m.stream == "sample" and (s := decode_sample(m.data))]

    assert len(run) == len(messages) == 497 + 6 + 5 + 3 + 3
    assert times == sorted(times)
    assert [s.k - K_FIRST for s in samples] == [i for i in range(N) if i not in MISSING]
    assert [s.u_applied_v for s in samples] == [applied()[s.k - K_FIRST] for s in samples]
    order = [
        decode_sample(m.data).k if m.stream == "sample" else int(_Gap.FromString(m.data).k_first)
        for m in messages
        if m.stream in ("sample", "gap")
    ]
    assert order == sorted(order)  # though the sample after the third gap came early
    last = max(s.t_host_ns for s in samples)
    assert run.seconds == pytest.approx(max(25.9, (last - ZERO_NS) / 1e9) - messages[0].t)
    assert {m.stream for m in of_part} == {"sample", "gap", "timing", "clock", "event"}
    assert sum(m.stream == "sample" for m in of_part) == (284 - 58) - 4 - 1 - 7 - 4
    assert all(2.9 <= m.t < 14.3 for m in of_part)


def test_columns_and_summary_contain_the_values_of_the_file(path: Path, odd: Recording) -> None:
    found, summary = export_columns(odd, raw=True), summary_of(path)
    row = 400

    np.testing.assert_array_equal(found["k"], np.arange(4_000, 4_518))
    assert found["t_sched_ns"][row] == due_ns(row)
    assert found["theta_1_counts"][120] == found["alpha_counts"][120] == 0
    assert found["alpha_counts"][30] == 65535
    angle = (found["alpha_counts"][row] - 30_000) * ODD.alpha.rad_per_count
    assert angle == pytest.approx(odd.alpha[row])
    assert (summary.kind, summary.is_validation, summary.name) == ("blackbox", True, "odd")
    assert summary.validation_of == "20261119T050000Z-0dad"
    assert (summary.samples, summary.missing, summary.seconds) == (497, 21, pytest.approx(25.9))
    assert (summary.device, summary.pacing, summary.rig) == ("beef", "scheduled", "7")
    of_odd = hashlib.sha256(msgspec.json.encode(ODD)).hexdigest()
    assert (summary.armrig, summary.calibration_sha256) == ("0.2.1", of_odd)
    assert summary.outcome == "stopped by bob"
    names = summary.names(validation=True)
    assert names == {"20261119T050000Z-0dad", "odd", "blackbox-odd"}
    assert "odd" not in summary.names(validation=False)
    assert summary.size == path.stat().st_size


def test_only_a_run_that_reached_its_end_is_complete(path: Path) -> None:
    summary = summary_of(path)

    complete = [
        code
        for code in OutcomeCode
        if msgspec.structs.replace(summary, outcome_code=code).is_complete
    ]

    assert complete == ["complete"]


def test_a_first_look_reports_the_drift_of_each_experiment(odd: Recording) -> None:
    alpha = odd.alpha + 0.05 * np.maximum(odd.t - 14.0, 0.0)

    found = overview(with_channel(odd, "alpha", alpha))

    rows = dict(found.rows())
    assert rows["drift, alpha 1"].startswith("no significant drift: ")
    assert rows["drift, alpha 2"].startswith("no significant drift: ")
    assert rows["drift, alpha 3"].startswith("a drift: 0.05 ± ")


def test_a_swinging_chassis_turns_by_the_difference_of_its_extremes(odd: Recording) -> None:
    swinging = np.where(odd.valid, 4.0 * np.sin(tau * odd.t / 0.7), np.nan)
    found = Overview(
        recording=with_channel(odd, "theta_1", swinging), outliers={}, drift={}, reasons={}
    )

    rate = (swinging[2:] - swinging[:-2]) / 0.1
    assert dict(found.rows())["theta_1"] == (
        f"the chassis turned 1.2 times, at {np.nanmin(rate):.3g} to {np.nanmax(rate):.3g} rad/s "
        "over 0.1 s"
    )


def test_an_outlier_is_reported_with_its_time(odd: Recording) -> None:
    alpha = odd.alpha.copy()
    alpha[[90, 330, 450]] += 0.5

    found = overview(with_channel(odd, "alpha", alpha))

    assert found.outliers["alpha"].tolist() == pytest.approx([4.5, 16.5, 22.5])
    assert dict(found.rows())["outliers, alpha"] == "3, at 4.5 s, 16.5 s, 22.5 s"
    for n, said in ((0, "none"), (5, "5, at 0 s, 1 s, 2 s, 3 s, 4 s"), (6, "4 s …")):
        rows = dict(replace(found, outliers={"alpha": np.arange(float(n))}).rows())
        assert rows["outliers, alpha"].endswith(said)


def test_each_failure_is_reported_with_its_figures(odd: Recording) -> None:
    def changed(row: int, **fields: float) -> Recording:
        samples = odd.samples.copy()
        at = int(np.searchsorted(samples["k"], K_FIRST + row))
        for name, value in fields.items():
            samples[name][at] = value
        known = tuple(g for g in odd.gaps if not isnan(g.u_held_v))
        return replace(odd, samples=samples, gaps=known)

    u, k = asked(), K_FIRST + 300
    last = odd.clock[2]
    # From 5 s to 20 s the offset gains 15 s at 85 ppm; ± is of both offsets and of that drift.
    jumped = replace(last, offset_ns=last.offset_ns + 900_000)
    t_us, due = odd.samples["t_device_us"][[0, -1]], odd.samples["t_sched_ns"][[0, -1]]
    ppm = (float(t_us[1] - t_us[0]) * 1e3 / float(due[1] - due[0]) - 1) * 1e6
    off_us = (80 - 85) * 15 + 900
    spread_us = np.sqrt(3.0**2 + 1.5**2 + (6.0 * 15) ** 2)
    texts = [
        check_envelope(changed(300, u_cmd_v=5.0, u_applied_v=0.0)).text,
        check_envelope(changed(300, u_cmd_v=5.25)).text,
        check_envelope(changed(300, u_applied_v=-0.125)).text,
        check_envelope(changed(300, u_cmd_v=nan)).text,
        check_input(changed(300, u_cmd_v=u[300] + 0.25), u).text,
        check_input(changed(300, u_cmd_v=u[300] + 2 * 5 / 65535), u).level,
        check_input(changed(300, u_applied_v=u[300] + 0.0098), u).level,  # half a step of 8 bits
        check_input(changed(300, u_applied_v=u[300] - 0.0099), u).level,
        check_input(odd, u[:-1]).text,
        check_input(changed(514, k=K_FIRST + 599), u).level,
        check_input(changed(514, k=K_FIRST + 600), u).text,
        check_input(changed(2, k=K_FIRST - 1), u).text,
        check_timing(changed(300, t_device_us=odd.samples["t_device_us"][0])).text,
        check_timing(changed(300, t_sched_ns=due_ns(299))).text,
        check_clock(replace(odd, clock=(*odd.clock[:2], jumped))).text,
        check_clock(replace(odd, clock=())).text,
        check_file(replace(odd, outcome=Outcome(outcome="x", samples=490, missing=28))).text,
    ]

    assert texts == [
        "0 to 3.301 V applied, inside 0 to 5 V",
        f"5.25 V was requested, outside 0 to 5 V, at k={k}",
        f"-0.125 V was applied, outside 0 to 5 V, at k={k}",
        f"nan V was requested, outside 0 to 5 V, at k={k}",
        f"1 sample with another voltage requested, the first at k={k}: {u[300] + 0.25:.6g} V "
        f"instead of {u[300]:.6g} V",
        "unusable",
        "good",
        "unusable",
        "599 voltages are attached, but the run has 600 samples",
        "unusable" if u[599] != u[514] else "good",
        "sample k=4600 is outside the 600 attached voltages",
        "sample k=3999 is outside the 600 attached voltages",
        f"the time of the device's clock does not increase at k={k}",
        f"the time of the host's clock does not increase at k={k}",
        f"the offset of the clocks jumps by {off_us} µs at 20.0 s "
        f"(standard deviation {spread_us:.0f} µs)",
        f"the device's clock is {ppm:+.1f} ppm off; no comparisons recorded",
        "it reports 490 samples and 28 missing samples, but contains 497 and 21",
    ]


@pytest.mark.parametrize(("Ts", "missing"), [(0.05, 5), (0.01, 25), (0.002, 125)])
def test_turns_are_lost_after_a_gap_longer_than_a_quarter_of_a_second(
    Ts: float, missing: int
) -> None:
    """The interval before the sample that came back is unseen, too: n samples hide n + 1."""
    present = np.ones(300, np.bool_)
    present[100 : 100 + missing] = False
    one_less = present.copy()
    one_less[100] = True

    assert turns_unknown(present, present, Ts).tolist() == [100 + missing]
    assert turns_unknown(one_less, one_less, Ts).tolist() == []


@pytest.mark.parametrize(("changes", "is_searched"), [(19, False), (20, True)])
def test_outliers_are_searched_if_the_input_changes_twenty_times(
    odd: Recording, changes: int, is_searched: bool
) -> None:
    """Fewer changes determine no model that separates an outlier from a swing."""
    u = 1.0 + (np.minimum(np.arange(odd.N) // 10, changes) % 2)

    found = overview(replace(odd, u=u))

    assert ("theta_1" in found.outliers) is is_searched
    reason = f"u changes {changes} times; with fewer than 20 changes"
    assert found.reasons.get("outliers", "").startswith(reason) is not is_searched


def test_the_duration_of_a_cut_file_includes_its_missing_samples(path: Path) -> None:
    data = path.read_bytes()
    cut = path.with_suffix(".active")
    cut.write_bytes(data[: len(data) * 2 // 3])

    rec = load(cut)

    came, saved = rec.samples.size, rec.damage.partition("; saved: ")[2]
    assert 250 < came < rec.N - 10
    assert saved.startswith(f"{came} samples, ")
    assert saved.endswith(f" of {len(data) * 2 // 3} B, {rec.N * TS:g} s of 30 s")
    assert rec.cut_off
