"""A calibration from recordings: figures within their own deviations, and what is refused."""

from __future__ import annotations

import re
from dataclasses import replace
from math import degrees, erf, sqrt, tau

import msgspec
import numpy as np
import pytest
from armrig.physics.calibration import estimate, sign_by_hand
from armrig.physics.calibration_readings import (
    Readings,
    compress_readings,
    mean_reading,
    noise_before_rounding,
    rounding_variance,
    spread,
)
from armrig.physics.calibration_turns import (
    TerminalVoltage,
    Turning,
    _interval_middle,
    speeds,
    terminal_voltage,
    turning,
)
from armrig.recordings.usability import doubts_of_calibration
from armrig_core.errors import InputError
from armrig_core.rig.calibration import Calibration, Made, MeasuredValue, Potentiometer
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.clients.calibration_rig import calibrated, truth, unknown_rig
from tests.clients.made_recordings import manifest
from tests.clients.made_turns import HIGH, LOW, D, made_turns, still, stored_readings
from tests.sampling import sampled

MADE = Made(date="2026-11-01T00:00:00+00:00", rig="1", device_uid="0001", armrig="0.1.0")


@pytest.mark.parametrize("seed", sampled([1000, 1001]))
def test_a_calibration_finds_the_figures_of_an_unknown_rig(seed: int) -> None:
    """Offsets, gains, directions, dead band and friction are each within four of their deviations.

    With four, hardly one of 26 true numbers in 600 fails. docs/calibration.md has the share within
    three.
    """
    rig = unknown_rig(seed)

    found = calibrated(rig)

    assert found.alpha_sign == (-1 if rig.alpha_reversed else 1)
    assert [w for w in found.warnings if "limits.u_max_v" not in w] == []
    figures, true = found.figures(), truth(rig)
    assert figures.keys() == true.keys()
    for name, value in true.items():
        assert abs(figures[name].value - value) <= 4 * figures[name].std, name
    # Deviations that say something: 0.01 % of a count's angle, 0.3° of the dead band, 20 mV.
    assert figures["theta_1_rad_per_count"].std < 2e-4 * abs(true["theta_1_rad_per_count"])
    assert degrees(figures["theta_1_dead_band_rad"].std) < 0.3
    assert figures["motor_zero_torque_v"].std < 0.02


@settings(max_examples=25)
@given(
    st.sampled_from([1, -1]),
    st.floats(1.2, 6.0),
    st.integers(0, 2**31),
)
def test_a_turn_is_found_at_any_speed_in_both_directions(
    direction: int, omega: float, seed: int
) -> None:
    readings = made_turns(direction=direction, noise=32.0, seed=seed, omega=(omega, omega + 1))

    found = turning(readings, 64.0)

    assert found.direction == direction
    assert found.per_turn.value == pytest.approx(D, abs=5 * found.per_turn.std)
    assert found.per_turn.std < 1e-3 * D
    for edge, true in ((found.low, LOW), (found.high, HIGH)):
        assert edge.value == pytest.approx(true, abs=4 * edge.std)
    speeds = found.direction * found.slopes * tau / D
    assert speeds == pytest.approx([omega, omega + 1], rel=1e-3)


def test_the_deviations_of_a_turn_hold_in_monte_carlo() -> None:
    found = [turning(made_turns(noise=32.0, seed=seed), 64.0) for seed in range(300)]

    for estimates, stds, true in (
        ([f.per_turn.value for f in found], [f.per_turn.std for f in found], D),
        (
            [f.slopes[0] for f in found],
            [sqrt(f.covariance[0, 0]) for f in found],
            1.9 * D / tau,
        ),
    ):
        assert np.std(estimates) == pytest.approx(np.mean(stds), rel=0.13)
        assert np.mean(estimates) == pytest.approx(true, abs=4 * np.mean(stds) / sqrt(300))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"u": np.zeros(2400)}, "no voltage was held for more than 3 s"),
        ({"first": np.zeros(2400)}, "theta_1 shows no angle"),
        ({"first": np.full(2400, 3000.0)}, "passed its dead band 0 times"),
        ({"first": np.tile([9000.0, 60_000.0], 1200)}, "did not turn in one direction"),
    ],
)
def test_a_run_without_full_turns_is_refused_with_the_remedy(
    change: dict[str, np.ndarray], said: str
) -> None:
    with pytest.raises(InputError, match=said) as refused:
        turning(replace(made_turns(), **change), 64.0)
    assert "three turns or more: see --volts" in str(refused.value)


def test_a_voltage_at_which_one_sample_shows_an_angle_is_refused() -> None:
    """One sample has no speed."""
    readings = made_turns(noise=32.0, omega=(3.7, 1.9))
    last = np.flatnonzero(readings.u == readings.u[-1])
    first = readings.first.copy()
    first[last] = 0.0
    first[last[-1]] = 30_000.0

    with pytest.raises(InputError, match="too few angles at one of the voltages"):
        turning(replace(readings, first=first), 64.0)


def test_an_edge_is_anywhere_between_two_readings_with_equal_probability() -> None:
    """A uniform distribution over 12 counts has the variance 12; that of the turn is added."""
    assert _interval_middle((10.0, 22.0), 4.0) == MeasuredValue(value=16.0, std=4.0)


def test_a_worn_track_is_reported() -> None:
    """On a worn track the straight line is no calibration."""
    readings = made_turns(noise=32.0)
    worn = (readings.first > 20_000) & (readings.first < 26_000)

    with pytest.raises(InputError, match=r"was at a rail at .* % of its track"):
        turning(replace(readings, first=np.where(worn, 0.0, readings.first)), 64.0)


def test_an_occasional_misreading_does_not_change_the_calibration() -> None:
    """Up to 2 % of the samples on the track may show a rail."""
    readings = made_turns(noise=32.0)
    spot = (readings.first > 55_000) & (readings.first < 55_700)

    found = turning(replace(readings, first=np.where(spot, 0.0, readings.first)), 64.0)

    assert 10 < np.count_nonzero(spot) < 40
    assert found.per_turn.value == pytest.approx(D, abs=4 * found.per_turn.std)
    assert found.per_turn.std < 1e-3 * D


def test_a_speed_that_is_not_constant_is_reported() -> None:
    """The angle of a count depends on the constant speed."""
    steady, readings = made_turns(noise=32.0), made_turns(noise=32.0)
    on = (readings.first > 3000) & (readings.first < 60_000)
    ripple = np.rint(500 * np.sin(8 * readings.t) / 64) * 64
    readings = replace(readings, first=readings.first + on * ripple)

    said = " ".join(estimate(still(), readings).warnings)

    assert "deviates from a constant speed" in said
    assert "deviates from a constant speed" not in " ".join(estimate(still(), steady).warnings)


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.2, 0.3, 0.5])
def test_the_variance_of_rounding_depends_on_the_noise(noise: float) -> None:
    """The reference is the mean square error of the mean reading over all positions in a step."""
    places = (np.arange(2000) + 0.5) / 2000
    steps = np.arange(-6, 8)
    if noise:
        normal = np.vectorize(lambda x: 0.5 * (1 + erf(x / sqrt(2))))
        cdf = normal((steps[:, None] - 0.5 - places) / noise)
        mean = (np.diff(cdf, axis=0) * steps[:-1, None]).sum(axis=0)
    else:
        mean = np.floor(places + 0.5)

    expected = np.mean((mean - places) ** 2)

    assert rounding_variance(1.0, noise) == pytest.approx(expected, rel=0.02, abs=1e-6)


@pytest.mark.parametrize(("noise", "step"), [(32.0, 64.0), (100.0, 64.0), (3.0, 4.0)])
def test_the_noise_before_rounding_is_found_from_rounded_readings(
    noise: float, step: float
) -> None:
    readings = noise * np.random.default_rng(3).standard_normal(20_000)
    rounded = np.rint(readings / step) * step

    assert noise_before_rounding(float(np.var(rounded)), step) == pytest.approx(noise, rel=0.03)
    assert noise_before_rounding(step**2 / 13, step) == 0.0


def test_equal_readings_have_the_deviation_of_a_converter_step() -> None:
    counts = np.full(400, 6400.0)

    assert mean_reading(counts, 64.0, 0.0).std == pytest.approx(64 / sqrt(12), rel=0.01)
    assert spread(counts, 64.0) == MeasuredValue(value=0.0, std=pytest.approx(64 / sqrt(400)))


def test_the_deviation_of_a_spread_holds_in_monte_carlo() -> None:
    """Rounded normal noise of half a step."""
    rng = np.random.default_rng(11)
    found = [spread(np.rint(10.3 + 0.5 * rng.standard_normal(300)) * 64, 64.0) for _ in range(2000)]

    scatter = np.std([f.value for f in found])
    assert np.mean([f.std for f in found]) == pytest.approx(scatter, rel=0.1)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"first": np.zeros(300)}, "theta_1 reads 0 .* turn the chassis out of the dead band"),
        ({"second": np.full(300, 65535.0)}, "alpha reads 65535 .* the arm hangs free"),
        ({"u": np.ones(300)}, "the motor was driven in the recording at rest"),
        (
            dict.fromkeys(("t", "u", "first", "second"), np.zeros(1)),
            "the recording at rest has 1 sample:",
        ),
    ],
)
def test_a_recording_that_is_not_at_rest_is_refused(
    change: dict[str, np.ndarray], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        estimate(replace(still(), **change))


@pytest.mark.parametrize(("t", "alpha"), [(np.zeros(3), np.zeros(2)), (np.zeros(0), np.zeros(0))])
def test_readings_are_columns_of_as_many_samples(t: np.ndarray, alpha: np.ndarray) -> None:
    with pytest.raises(InputError, match="all four must have the same number, and at least 1"):
        Readings(t=t, u=t, first=t, second=alpha)


def test_without_a_motor_zeros_and_the_sign_by_hand_are_determined() -> None:
    held = replace(still(), second=still().second - 3000.0)
    base = Calibration(theta_1=Potentiometer(rad_per_count=-1e-4))

    found = estimate(still(), deflected=held, base=base)
    calibration = found.calibration(base, MADE)

    assert found.alpha_sign == -1
    assert calibration.theta_1.rad_per_count == -1e-4
    assert calibration.theta_1.zero_counts == pytest.approx(20_000, abs=10)
    assert calibration.alpha.rad_per_count == -base.alpha.rad_per_count
    assert calibration.made is not None
    assert "theta_1_rad_per_count" not in calibration.made.figures


@pytest.mark.parametrize("counts", [3000.0, -3000.0])
@pytest.mark.parametrize("rad_per_count", [1e-4, -1e-4])
def test_a_lasting_deflection_by_hand_determines_the_sign_of_alpha(
    counts: float, rad_per_count: float
) -> None:
    """Then the arm hangs again, or swings a little to the other side."""
    rest = MeasuredValue(value=20_000.0, std=1.0)
    alpha = np.full(300, rest.value)
    alpha[100:200] += counts
    alpha[200:250] -= counts / 10

    held = replace(still(), second=alpha)

    assert sign_by_hand(held, rest, rad_per_count) == np.sign(counts)


@pytest.mark.parametrize("rad_per_count", [1e-4, -1e-4])
def test_the_direction_of_alpha_is_kept_without_a_deflection(rad_per_count: float) -> None:
    base = Calibration(
        theta_1=Potentiometer(rad_per_count=3e-4, wraps=False),
        alpha=Potentiometer(rad_per_count=rad_per_count, wraps=True),
    )

    found = estimate(still()).calibration(base, MADE)

    assert (found.theta_1.rad_per_count, found.theta_1.wraps) == (3e-4, False)
    assert (found.alpha.rad_per_count, found.alpha.wraps) == (rad_per_count, True)
    assert found.driver == base.driver


def test_a_motion_at_rest_is_reported_with_its_deviation() -> None:
    """700 counts of 65536 are 3.8°."""
    swing = 700 * np.sqrt(2) * np.sin(tau * np.arange(300) / 30)

    for name, field in (("theta_1", "first"), ("alpha", "second")):
        moved = replace(still(), **{field: np.rint((20_000 + swing) / 64) * 64})
        [said] = [text for text in estimate(moved).warnings if "moved" in text]
        assert re.fullmatch(
            rf"{name} moved in the recording at rest: .* is 70\d counts, 3\.[89]°", said
        )


def test_the_deviations_of_count_and_dead_band_follow_from_track_and_turn() -> None:
    found = estimate(still(), made_turns(noise=32.0))
    turned, count, band = found.turned, found.rad_per_count, found.dead_band
    assert turned is not None
    assert count is not None
    assert band is not None
    low, high, d = turned.low, turned.high, turned.per_turn

    track = (high.value - low.value) / d.value
    assert abs(count.value) == pytest.approx(tau / d.value)
    assert count.std == pytest.approx(tau / d.value**2 * d.std)
    assert band.value == pytest.approx(tau * (1 - track))
    parts = (low.std / d.value, high.std / d.value, track * d.std / d.value)
    assert band.std == pytest.approx(tau * np.linalg.norm(parts))


def test_a_small_deflection_determines_no_sign() -> None:
    rest = MeasuredValue(value=20_000.0, std=1.0)
    touched = replace(still(), second=still().second + 100)

    assert sign_by_hand(touched, rest, 1e-4) == 0
    assert "alpha keeps the configured sign" in " ".join(estimate(still()).warnings)


def test_the_driver_line_is_fitted_to_the_readings_of_the_meter() -> None:
    """Two readings give gain and offset, one gives the gain alone."""
    two = terminal_voltage([(1.0, 1.02), (4.0, 3.96)], 0.01)
    one = terminal_voltage([(2.0, 1.9)], 0.01)

    assert two is not None
    assert one is not None
    assert (two.gain.value, two.offset.value) == pytest.approx((0.98, 0.04))
    assert two.gain.std == pytest.approx(0.01 * sqrt(2) / 3)
    assert (one.gain, one.offset) == (
        MeasuredValue(value=0.95, std=0.005),
        MeasuredValue(value=0.0, std=0.0),
    )
    assert terminal_voltage([], 0.01) is None
    with pytest.raises(InputError, match="read the meter at another code, too"):
        terminal_voltage([(1.0, 1.0), (1.0, 1.1)], 0.01)


def test_the_deviations_of_speed_and_standstill_follow_from_slopes_turn_and_meter() -> None:
    """With two voltages no weight matters: J P J^T, with central differences by five numbers."""
    x = np.array([2.0e4, 6.0e4, 67_000.0, 0.05, 0.95])  # slopes, counts of a turn, offset, gain
    P = np.zeros((5, 5))
    P[:3, :3] = [[900.0, 300.0, 100.0], [300.0, 1600.0, -50.0], [100.0, -50.0, 400.0]]
    P[3:, 3:] = [[4e-4, -1e-4], [-1e-4, 5e-5]]

    def found(x: np.ndarray) -> list[MeasuredValue]:
        turned = Turning(
            direction=1,
            per_turn=MeasuredValue(value=x[2], std=20.0),
            low=MeasuredValue(value=0.0, std=1.0),
            high=MeasuredValue(value=65_000.0, std=1.0),
            turns=9,
            volts=np.array([1.5, 3.5]),
            slopes=x[:2],
            covariance=P[:3, :3],
            residual_variance=1.0,
        )
        line = speeds(turned, TerminalVoltage(line=x[3:], covariance=P[3:, 3:]))
        assert line is not None
        return [line.rate, line.zero_torque]

    h = np.diag(1e-5 * np.abs(x))
    by = [[f.value for f in found(x + d)] for d in h], [[f.value for f in found(x - d)] for d in h]
    J = (np.array(by[0]) - np.array(by[1])).T / (2 * np.diag(h))

    assert [f.std for f in found(x)] == pytest.approx(np.sqrt(np.diag(J @ P @ J.T)), rel=1e-6)


def test_a_line_through_readings_close_together_keeps_its_digits() -> None:
    """The matrix is not squared: of sixteen digits the codes lose six, not twelve."""
    codes = (4.99999, 5.0)

    found = terminal_voltage([(u, 0.1 + 0.9 * u) for u in codes], 0.01)

    assert found is not None
    assert found.offset.value == pytest.approx(0.1, abs=1e-8)
    assert found.gain.value == pytest.approx(0.9, abs=1e-9)
    assert found.gain.std == pytest.approx(0.01 * sqrt(2) / 1e-5, rel=1e-9)


def test_a_driver_above_the_rig_s_limit_is_reported_with_the_limit_to_set() -> None:
    """The driver gives 5.3 V at the code of 5 V."""
    strong = estimate(still(), meter=[(1.0, 1.06)]).warnings
    weak = estimate(still(), meter=[(1.0, 0.98)]).warnings
    shifted = estimate(still(), meter=[(1.0, 1.15), (4.0, 4.3)]).warnings  # 0.1 V + 1.05 u

    assert "a code of 5 V applies 5.35 V to the motor" in " ".join(shifted)
    assert "set limits.u_max_v = 4.67 or less" in " ".join(shifted)
    assert "applies 5.30 V" in " ".join(strong)
    assert "set limits.u_max_v = 4.72 or less" in " ".join(strong)
    assert "u_max_v" not in " ".join(weak)


def test_the_samples_are_compressed_without_loss() -> None:
    """The hash of the bytes names the samples."""
    sources = {"rest": still(), "turns": made_turns(noise=32.0)}

    data = compress_readings(sources)
    back = stored_readings(data)

    assert data == compress_readings(sources)
    assert data[4:8] == bytes(4), "no time in gzip's head"
    assert len(data) < 12 * sum(r.N for r in sources.values())
    for name, readings in sources.items():
        for column in ("u", "first", "second"):
            assert np.array_equal(getattr(back[name], column), getattr(readings, column))
        assert back[name].t == pytest.approx(readings.t, abs=1e-9)


@pytest.mark.parametrize(
    ("calibration", "changes", "said"),
    [
        (None, {}, "has no calibration"),
        (Calibration(), {}, "was not calibrated"),
        (Calibration(made=MADE), {}, ""),
        (Calibration(made=MADE), {"device": {"uid": "0002"}}, "of another device: .* 0001"),
        (Calibration(made=MADE), {"device": {"uid": "0002"}, "rig": "2"}, "of another device"),
        (Calibration(made=MADE), {"device": {}}, "made on 0001, .* on a device without an id"),
        (
            Calibration(made=msgspec.structs.replace(MADE, device_uid="")),
            {},
            "made on none, the recording was made on 0001",
        ),
        (Calibration(made=MADE), {"rig": "2"}, "of rig 1, and the recording is of rig 2"),
        (Calibration(made=MADE), {"started": "2026-12-02T00:00:01+00:00"}, "31 days old"),
        (Calibration(made=MADE), {"started": "2026-12-01T00:00:00+00:00"}, ""),
        (Calibration(made=MADE), {"started": "2026-10-01T00:00:00+00:00"}, ""),
        (Calibration(made=MADE), {"started": "2026-11-20"}, "age .* not known"),
    ],
)
def test_a_calibration_that_is_missing_or_stale_is_reported(
    calibration: Calibration | None, changes: dict[str, object], said: str
) -> None:
    found = [f.text for f in doubts_of_calibration(calibration, manifest(**changes))]

    assert len(found) == bool(said)
    assert re.search(said, " ".join(found))


def test_a_figure_of_a_calibration_without_turns_is_refused() -> None:
    with pytest.raises(InputError, match="without turns"):
        estimate(still()).plot(made_turns(noise=32.0))
