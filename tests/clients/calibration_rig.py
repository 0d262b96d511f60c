"""A rig of unknown offsets, gains, directions and dead band, calibrated in virtual time."""

from __future__ import annotations

from math import erf, radians, sqrt, tau
from struct import pack

import numpy as np
from armrig.physics.calibration import CalibrationEstimate, estimate
from armrig.physics.calibration_readings import Readings
from armrig_core.rig.arm import ArmParameters
from armrig_core.rig.calibration import Calibration
from armrig_core.rig.volts import code_of, device_code, volts_of
from armrig_core.telemetry.telemetry import decode_sample
from armrig_daemon.config import Config
from armrig_daemon.emulator.board import driver_volts, volts
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.pipe import Arm, Run, RunStarted
from armrig_daemon.virtual import VirtualRig
from armrig_protocol.messages import Flag
from numpy.typing import NDArray

from tests.clients.made_recordings import manifest, recorded, sample

LEASE = "a" * 32
TS = 0.01
REST = np.zeros(300)
TURNS = np.repeat([0.0, 1.0, 2.0, 3.0, 0.0], [50, 1200, 900, 700, 50])
METER_CODES = (13107, 32768, 58982)
METER_STD_V = 0.01


def unknown_rig(seed: int) -> EmulatorSettings:
    """Return an uncalibrated rig, at rest on its track."""
    rng = np.random.default_rng([seed, 4])
    range_deg = rng.uniform(320, 356)
    low, high = rng.choice([0.0, rng.uniform(0.05, 0.4)]), rng.choice([5.0, rng.uniform(4.5, 4.95)])
    return EmulatorSettings(
        seed=seed,
        boot_ms=0.0,
        adc_noise_v=rng.uniform(0.0005, 0.006),
        theta_1_range_deg=range_deg,
        theta_1_zero_deg=rng.uniform(15, range_deg - 15),
        theta_1_low_v=low,
        theta_1_high_v=high,
        theta_1_reversed=bool(rng.integers(2)),
        alpha_zero_deg=rng.uniform(120, 230),
        alpha_reversed=bool(rng.integers(2)),
        driver_gain=rng.uniform(0.9, 1.05),
        driver_offset_v=rng.uniform(-0.08, 0.08),
        coulomb_nm=rng.uniform(0.0, 0.03),
    )


def runs(settings: EmulatorSettings, *inputs: NDArray[np.float64]) -> list[Readings]:
    """Play inputs one after the other on one rig; return the recordings, in scheduled pacing."""
    rig = VirtualRig(Config().rules(), settings)
    rig.run_until(300_000_000)
    found = []
    for i, u in enumerate(inputs):
        rig.order(Arm(order=3 * i + 1, owner="a test", lease=LEASE, ts_us=round(TS * 1e6)))
        rig.run_until(rig.ports.now + 200_000_000)
        codes = pack(f"<{u.size}H", *map(code_of, u))
        rig.records.clear()
        rig.order(
            Run(order=3 * i + 2, lease=LEASE, n=i, run_id=str(i), codes=codes, scheduled=True)
        )
        rig.run_until(rig.ports.now + round((u.size * TS + 0.5) * 1e9))
        (started,) = (r for r in rig.records if isinstance(r, RunStarted))
        decoded = (decode_sample(r) for r in rig.records if isinstance(r, bytes))
        samples = [s for s in decoded if s and 0 <= s.k - started.k_first < u.size]
        assert len(samples) == u.size
        t_us, u_v, theta_1, alpha = np.array(
            [(s.t_device_us, s.u_applied_v, s.counts_0, s.counts_1) for s in samples],
            dtype=np.float64,
        ).T
        found.append(Readings(t=(t_us - t_us[0]) * 1e-6, u=u_v, first=theta_1, second=alpha))
    return found


def calibrated(settings: EmulatorSettings) -> CalibrationEstimate:
    """Return the calibration of an emulated rig, read with a meter, too."""
    rest, turns = runs(settings, REST, TURNS)
    rng = np.random.default_rng([settings.seed, 5])
    meter = [
        (
            volts_of(device_code(code, settings.pwm_bits)),
            driver_volts(
                volts(code, settings.pwm_bits), settings.driver_gain, settings.driver_offset_v
            )
            + METER_STD_V * rng.standard_normal(),
        )
        for code in METER_CODES
    ]
    return estimate(rest, turns, meter=meter, meter_std_v=METER_STD_V)


def truth(settings: EmulatorSettings) -> dict[str, float]:
    """Return the true values of `CalibrationEstimate.figures`."""
    low, high = (v / 5 * 65536 for v in (settings.theta_1_low_v, settings.theta_1_high_v))
    span, range_1 = high - low, radians(settings.theta_1_range_deg)
    sign = -1.0 if settings.theta_1_reversed else 1.0
    zero = low + span * radians(settings.theta_1_zero_deg) / range_1
    alpha_span = (settings.alpha_high_v - settings.alpha_low_v) / 5 * 65536
    alpha_zero = settings.alpha_low_v / 5 * 65536
    alpha_zero += alpha_span * settings.alpha_zero_deg / settings.alpha_range_deg
    noise, step = settings.adc_noise_v / 5 * 65536, float(1 << 16 - settings.adc_bits)
    arm = ArmParameters()
    return {
        "theta_1_zero_counts": zero,
        "theta_1_rad_per_count": sign * range_1 / span,
        "theta_1_low_counts": low,
        "theta_1_high_counts": high,
        "theta_1_dead_band_rad": tau - range_1,
        "theta_1_noise_counts": _rounded_noise(zero, noise, step),
        "alpha_zero_counts": alpha_zero,
        "alpha_noise_counts": _rounded_noise(alpha_zero, noise, step),
        "resolution_counts": step,
        "driver_gain": settings.driver_gain,
        "driver_offset_v": settings.driver_offset_v,
        "motor_zero_torque_v": settings.coulomb_nm / arm.torque_per_volt,
        "motor_rad_per_s_v": arm.torque_per_volt / arm.damping,
    }


def _rounded_noise(place: float, noise: float, step: float) -> float:
    """Return the standard deviation of readings of a constant voltage with noise, rounded."""
    steps = np.arange(np.floor(place / step) - 8, np.floor(place / step) + 10)
    edges = ((steps - 0.5) * step - place) / noise
    cdf = np.array([0.5 * (1 + erf(e / sqrt(2))) for e in edges])
    p, values = np.diff(cdf), steps[:-1] * step
    mean = float(p @ values)
    return sqrt(float(p @ (values - mean) ** 2))


def recording_of(
    readings: Readings,
    experiment: str,
    calibration: Calibration = Calibration(),  # noqa: B008 - frozen
    **changes: object,
) -> bytes:
    """Return readings as the daemon records them, with the calibration in force."""
    at_rail = (np.abs(readings.first - 32768) >= 32768 - 64).tolist()
    samples = [
        sample(
            k,
            t_device_us=5_000 + round(t * 1e6),
            u_applied_v=u,
            counts_0=round(y0),
            counts_1=round(y1),
            flags=int(Flag.ADC0_RAIL) if rail else 0,
        )
        for k, (t, u, y0, y1, rail) in enumerate(
            zip(
                *(c.tolist() for c in (readings.t, readings.u, readings.first, readings.second)),
                at_rail,
                strict=True,
            )
        )
    ]
    fields = {"experiment": experiment, "samples": readings.N, "details": {}}
    about = manifest(**(fields | changes))
    return recorded(samples, manifest=about, calibration=calibration)
