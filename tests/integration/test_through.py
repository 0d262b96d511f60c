"""From the emulated rig through loop, recording and loading to a model: the true one comes back.

The loop and the device run in virtual time; everything else is what a user runs.
"""

from __future__ import annotations

import threading
from pathlib import Path
from struct import pack

import armrig
import msgspec
import numpy as np
import pytest
from armrig_core.arm import ArmParameters, arm_matrices, zero_order_hold
from armrig_core.codes import COMPLETE
from armrig_core.manifest import CALIBRATION, Manifest
from armrig_core.recording_file.outgoing import Outgoing
from armrig_core.recording_file.recorder import Recording
from armrig_core.telemetry import decode_sample
from armrig_core.volts import code_of
from armrig_daemon.config import Config
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.pipe import Arm, Run, RunStarted
from armrig_daemon.virtual import VirtualRig
from numpy.typing import NDArray

SEEDS = range(10)
N, Ts = 3000, 0.01
OMEGA = np.geomspace(0.5, 60, 200)
LEASE = "a" * 32


def _record(seed: int, path: Path) -> Path:
    """Play a telegraph on the demo's emulator and record it."""
    config = Config()
    rig = VirtualRig(config.rules(), EmulatorSettings(seed=seed))
    u = armrig.telegraph(N, 0.05, low=0.0, high=5.0, seed=seed)
    rig.run_until(300_000_000)
    rig.order(Arm(order=1, owner="a test", lease=LEASE, ts_us=0))
    rig.run_until(400_000_000)
    codes = pack(f"<{N}H", *map(code_of, u))
    rig.order(Run(order=2, lease=LEASE, n=0, run_id="r", codes=codes))
    rig.run_until(31_000_000_000)
    (started,) = (r for r in rig.records if isinstance(r, RunStarted))
    manifest = Manifest(
        **{"rig": "1", "run_id": "r", "experiment": "blackbox", "details": {"seed": seed}},
        **{"Ts": Ts, "samples": N, "started": "2026-01-01T00:00:00+00:00"},
        **{"clock_offset_ns": 0, "armrig": "0", "protocol": "1"},
    )
    recording = Recording(
        path,
        manifest,
        {CALIBRATION: msgspec.json.encode(config.calibration)},
        t_first_ns=started.t_host_ns,
        changed=threading.Event().set,
    )
    for data in (r for r in rig.records if isinstance(r, bytes)):
        s = decode_sample(data)
        if s is not None and 0 <= s.k - started.k_first < N:
            recording.add([Outgoing("sample", s.t_host_ns, s.t_sched_ns, s.k, data)])
    recording.finish(COMPLETE)
    recording.join(30)
    return path


def _true() -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Return b1 … b4, f1 … f4 of the exactly discretised plant, and its frequency response."""
    A, B, C = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, Ts)
    F = np.poly(Phi)
    # Markov parameters times F give the numerator.
    g = [(C[:1] @ np.linalg.matrix_power(Phi, i) @ Gamma)[0, 0] for i in range(4)]
    b = np.convolve(g, F)[:4]
    z = np.exp(1j * OMEGA * Ts)
    G = [(C[:1] @ np.linalg.solve(zi * np.eye(4) - Phi, Gamma))[0, 0] for zi in z]
    return np.r_[b, F[1:]], np.array(G)


@pytest.fixture(scope="module")
def fits(tmp_path_factory: pytest.TempPathFactory) -> list[armrig.Fit]:
    """Return the OE model of the whole plant from each seed's recording."""
    folder = tmp_path_factory.mktemp("through")
    recordings = [armrig.load(_record(seed, folder / f"{seed}.mcap")) for seed in SEEDS]
    data = [recording.dataset(output="theta_1") for recording in recordings]
    return [armrig.oe(d, nb=4, nf=4, nk=1, integrator=True) for d in data]


@pytest.mark.exhaustive
def test_the_frequency_response_is_the_plant_s(fits: list[armrig.Fit]) -> None:
    """Within 5 % rms over 0.5 to 60 rad/s, in every seed."""
    _, G = _true()

    errors = [np.sqrt(np.mean(np.abs(f.frequency_response(OMEGA).G / G - 1) ** 2)) for f in fits]

    assert max(errors) < 0.05, np.round(errors, 4)


@pytest.mark.exhaustive
def test_every_coefficient_is_within_3_sigma(fits: list[armrig.Fit]) -> None:
    """In at least 9 of 10 seeds each."""
    true, _ = _true()
    names = ("b1", "b2", "b3", "b4", "f1", "f2", "f3", "f4")
    inside = np.zeros(len(names), dtype=int)
    for fit in fits:
        at = [fit.names.index(name) for name in names]
        inside += np.abs(fit.theta[at] - true) <= 3 * fit.std[at]

    assert (inside >= 9).all(), dict(zip(names, inside, strict=True))


@pytest.mark.exhaustive
def test_the_standard_deviations_are_not_too_large_either(fits: list[armrig.Fit]) -> None:
    """Over seeds the estimates scatter as reported."""
    true, _ = _true()
    at = [fits[0].names.index(name) for name in ("b1", "b2", "b3", "b4")]

    scatter = np.sqrt(np.mean([(f.theta[at] - true[:4]) ** 2 for f in fits], axis=0))
    reported = np.mean([f.std[at] for f in fits], axis=0)

    # Ten seeds: the ratio's own standard deviation is 1 / sqrt(20) = 0.22.
    assert np.all(scatter / reported > 1 - 3 * 0.22)
    assert np.all(scatter / reported < 1 + 3 * 0.22)
