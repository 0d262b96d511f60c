"""A recording without any default, and the results that a reader must find.

It begins at k = 4000 with two missing samples and was stopped before its end. theta_1 falls through
negative angles. No clock, converter, calibration or report has a default.
"""

from __future__ import annotations

from math import nan, radians, tau
from typing import Any

import numpy as np
from armrig.excitation import telegraph
from armrig.physics.calibration_readings import Readings
from armrig_core.commands.commands import Rehearsal
from armrig_core.recording_file.manifest import Manifest, Outcome
from armrig_core.rig.arm import ArmParameters, arm_matrices, zero_order_hold
from armrig_core.rig.calibration import Calibration, Driver, Made, Potentiometer
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.telemetry import Sample
from armrig_protocol.messages import Flag
from msgspec.structs import replace

from tests.clients.made_recordings import OFFSET_NS, manifest, recorded

TS, K_FIRST, ASKED, N = 0.05, 4_000, 600, 518
ZERO_NS, SLOW_PPM = 3_000_000_000, 80.0
ODD = Calibration(
    theta_1=Potentiometer(zero_counts=20_000.0, rad_per_count=-radians(350) / 65536),
    alpha=Potentiometer(zero_counts=30_000.0, rad_per_count=-1e-4, wraps=False),
    driver=Driver(gain=0.9, offset_v=0.2),
    made=Made(date="2026-09-30T23:50:00+02:00", rig="8", device_uid="beef", armrig="0.0.9"),
)
FORWARD = replace(ODD, theta_1=Potentiometer(zero_counts=2e4, rad_per_count=radians(350) / 65536))
"""With it theta_1 counts with the motor, as the model of the rig has it."""
GAPS = ((0, 2, 0.0, "no answer"), (60, 1, 1.0, "a frame was lost"), (62, 3, 2.0, "link silent"))
GAPS += ((200, 7, 1.5, "link silent"), (280, 4, nan, "not recorded"), (515, 3, 0.5, "stopped"))
"""First row, number, voltage held in V, and reason; row 120 is missing without a record."""
MISSING = sorted({120} | {row for first, n, *_ in GAPS for row in range(first, first + n)})
CLIPPED = (30, 31, 150)
"""Rows in which alpha is at its rail."""


def asked() -> Any:
    """Return the requested voltages, (600,) in V; some are 0."""
    return telegraph(ASKED, 0.2, low=0.0, high=3.3, seed=9)


def applied() -> Any:
    """Return the voltages that a device of 8 bits applies, in V."""
    return np.round(asked() / 5 * 256) * 5 / 256


def held() -> Any:
    """Return the voltage held by the device from each row on, (518,) in V."""
    u = applied()[:N]
    for first, n, volts, _ in GAPS:
        u[first : first + n] = u[first : first + n] if np.isnan(volts) else volts
    return u


def angles() -> tuple[Any, Any]:
    """Return theta_1 and alpha in rad, (518,) each: the sensors count against the motor."""
    A, B, C = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, TS)
    x, y = np.array([2.5, 0.0, 0.0, 0.0]), []
    for volts in held():
        y.append(-C @ x)
        x = Phi @ x + Gamma[:, 0] * (ODD.driver.gain * volts + ODD.driver.offset_v * (volts > 0))
    theta_1, alpha = np.array(y).T
    return theta_1, alpha


def odd_recording(**changes: Any) -> bytes:
    """Return the recording; `changes` are of its manifest."""
    rng = np.random.default_rng(7)
    u, at_motor, (theta_1, alpha) = asked(), applied(), angles()
    late_us = np.round(700 + 300 * rng.exponential(size=N))
    late_us[[65, 300]] = -200, -450  # two that came early, one of them after a gap
    jitter_us = np.round(40 * rng.standard_normal(N))
    gaps = {first: _gap(first, n, volts, why) for first, n, volts, why in GAPS}
    reports = _reports()
    messages: list[Any] = []
    for row in range(N):
        messages += [gaps[row]] if row in gaps else []
        if row not in MISSING:
            counts_1, counts_2 = _counts(theta_1[row], alpha[row], rng)
            clipped, hidden = row in CLIPPED, counts_1 == 0
            flags = Flag.RUN | (Flag.ADC0_RAIL if hidden else 0) | (Flag.ADC1_RAIL * clipped)
            messages.append(
                Sample(
                    k=K_FIRST + row,
                    t_sched_ns=due_ns(row),
                    t_host_ns=due_ns(row) + int(late_us[row]) * 1_000,
                    t_device_us=9_000_000
                    + round(row * TS * (1e6 - SLOW_PPM))
                    + int(jitter_us[row]),
                    value_0=nan,
                    value_1=nan,
                    u_cmd_v=float(u[row]),
                    u_applied_v=float(at_motor[row]),
                    counts_0=counts_1,
                    counts_1=65535 if clipped else counts_2,
                    flags=int(flags),
                )
            )
        messages += reports.get(row, [])
    ended = Outcome(outcome="stopped by bob", samples=N - len(MISSING), missing=len(MISSING))
    return recorded(
        messages,
        manifest=_about(**changes),
        calibration=ODD,
        outcome=ended,
        u=u.tolist(),
        flush_every=100,
    )


def _about(**changes: Any) -> Manifest:
    fields: dict[str, Any] = {
        "rig": "7",
        "run_id": "20261120T050000Z-0bad",
        "experiment": "blackbox-validation-odd",
        "details": {"validation_of": "20261119T050000Z-0dad", "seed": 9, "a": 0.2},
        "owner": "collect (certificate alice)",
        "Ts": TS,
        "samples": ASKED,
        "k_first": K_FIRST,
        "pacing": "scheduled",
        "started": "2026-11-20T01:30:00-03:30",
        "armrig": "0.2.1",
        "device": {"firmware": "uno", "adc_bits": 12, "pwm_bits": 8, "uid": "beef"},
        "host": {"kernel": "6.12.1", "scheduling": "SCHED_FIFO"},
        "rehearsal": Rehearsal(revolutions=9.0, alpha_rad=0.3, turned_rad=-50.0),
    }
    return manifest(**(fields | changes))


def due_ns(row: int) -> int:
    """Return when a row was due, on the host's monotonic clock, in ns."""
    return ZERO_NS + round(row * TS * 1e9)


def _counts(theta_1: float, alpha: float, rng: np.random.Generator) -> tuple[int, int]:
    """Return the reading of a 12-bit converter with noise of a step; 0 in the dead band."""
    pot, noise = ODD.theta_1, 16 * rng.standard_normal(2)
    at = (theta_1 / pot.rad_per_count + pot.zero_counts) % (tau / abs(pot.rad_per_count))
    other = alpha / ODD.alpha.rad_per_count + ODD.alpha.zero_counts
    inside = 64 <= at + noise[0] < 65536 - 64
    return (round((at + noise[0]) / 16) * 16 if inside else 0), round((other + noise[1]) / 16) * 16


def _gap(first: int, n: int, volts: float, why: str) -> Any:
    return protobuf.message_class(protobuf.GAP)(
        k_first=K_FIRST + first,
        count=n,
        t_from_ns=due_ns(first),
        t_to_ns=due_ns(first + n),
        u_held_v=volts,
        reason=why,
    )


def _reports() -> dict[int, list[Any]]:
    """Return by row: five seconds of timing, three comparisons of the clocks, three events."""
    reports: dict[int, list[Any]] = {}
    timings = ((2, None, 3, 0, 90e3), (2, 12.0, 1, 20, 4e3), (3, 31.0, 7, 20, 6.5e3))
    timings += ((5, 8.0, None, 20, 5e3), (6, 9.0, 2, 0, 80e3))
    for i, (collections, pressure, queue, n, trip_us) in enumerate(timings):
        one = protobuf.message_class(protobuf.TIMING)(t_host_ns=due_ns(20 * (i + 1)))
        one.link_round_trip_us.n, one.link_round_trip_us.max = n, trip_us
        one.wake_lateness_us.p99, one.queue_depth.p50 = 10.0 + i, 4.0 - i
        one.collections = collections
        if pressure is not None:
            one.cpu_pressure_percent = pressure
        if queue is not None:
            one.run_queue = queue
        reports[20 * (i + 1)] = [one]
    for row, std_ns, drift, drift_std in ((25, 9e3, 70.0, 20.0), (100, 3e3, 85.0, 6.0)):
        reports.setdefault(row, []).append(_clock(row, std_ns, drift, drift_std))
    reports[400] = [_clock(400, 1.5e3, 81.0, 1.2)]
    stall = "emulator held up {} ms by this machine; its device's clock stood still"
    for row, level, said, stall_ms in (
        (41, "info", "a lease was renewed", 0),
        (210, "warning", stall.format(35), 35),
        (390, "error", stall.format(7), 7),
    ):
        log = protobuf.message_class(protobuf.LOG)(level=protobuf.LEVELS[level], message=said)
        log.timestamp.FromNanoseconds(due_ns(row) + OFFSET_NS)
        log.emulator_stall_ns = stall_ms * 1_000_000
        reports.setdefault(row, []).append(log)
    return reports


def _clock(row: int, std_ns: float, drift: float, drift_std: float) -> Any:
    return protobuf.message_class(protobuf.CLOCK)(
        t_host_ns=due_ns(row),
        offset_ns=ZERO_NS - 9_000_000_000 + round(row * TS * 1e3 * SLOW_PPM),
        offset_std_ns=std_ns,
        drift_ppm=drift,
        drift_std_ppm=drift_std,
        bound_ns=2e3,
    )


def odd_turns() -> tuple[Readings, Readings]:
    """Return a rest and turns of a shaft that counts down, 1.8 rad/s for each volt above 0.2 V.

    A turn is 70000 counts, the track from 2000 to 61000; alpha falls with growing counts. The
    voltages neither rise nor are whole, and one of them is too short to count.
    """
    rng, n = np.random.default_rng(12), [60, 900, 120, 700, 800]
    u = np.repeat([0.0, 2.5, 4.0, 0.8, 1.6], n)
    t = 0.01 * np.arange(u.size)
    place = 30_000 - 70_000 / tau * np.cumsum(1.8 * np.maximum(u - 0.2, 0)) * 0.01
    place = (place - 2_000) % 70_000 + 2_000
    noise = 20 * rng.standard_normal((2, u.size))
    theta_1 = np.where(place > 61_000, 0.0, np.rint((place + noise[0]) / 16) * 16)
    swing = 900 * np.exp(-np.maximum(t - 0.6, 0) / 0.2) * (t >= 0.62)
    turns = Readings(t=t, u=u, first=theta_1, second=np.rint((25_000 + swing + noise[1]) / 16) * 16)
    rest = np.rint((np.array([[41_000], [25_000]]) + 20 * rng.standard_normal((2, 250))) / 16) * 16
    return Readings(t=t[:250], u=np.zeros(250), first=rest[0], second=rest[1]), turns
