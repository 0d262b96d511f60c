"""Deviations of the rig's poles from theta_1 and alpha together, against one output alone.

Each run simulates the handout's arm (Ts 10 ms, N 3000, telegraph, 5 mrad of white noise on each
angle), or takes a recording of the emulated rig in virtual time (--emulated). The poles are
estimated from both outputs, from theta_1 alone and from alpha alone. The summary gives the scatter
of the pair, sqrt(var Re + var Im), and of the real pole, relative to theta_1 alone, and the
coverage of 95 % intervals. Runs are appended to the file, so that a study can be resumed. Run it
with the project's environment::

    python -m tests.benchmarks.both_outputs FILE [--runs 2000] [--seed 1] [--emulated]
    python -m tests.benchmarks.both_outputs FILE --summary
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import armrig
import control
import numpy as np
from armrig import ArmParameters, Signals
from armrig_core.commands import Run
from armrig_daemon.config import Config
from armrig_daemon.service.virtual_service import LEASE, VirtualService

from tests.benchmarks.several_greybox import STD, TS

_N = 3000
_OUTPUTS = ("theta_1", "alpha")


def truth() -> Any:
    """Return the pole of the pair above the axis, and the real pole."""
    sampled = control.c2d(armrig.arm(ArmParameters()), TS)
    z = np.linalg.eigvals(sampled.A)
    z = z[np.argsort(np.abs(z - 1))][1:]  # without the integrator
    real = z[np.argmin(np.abs(z.imag))].real
    return np.array([z[np.argmax(z.imag)], real])


def simulated(seed: int, run: int) -> Signals:
    """Return the outputs of the handout's arm with noise."""
    rng = np.random.default_rng([seed, run])
    u = armrig.telegraph(_N, 0.05, 0.0, 5.0, seed=rng)
    sampled = control.c2d(armrig.arm(ArmParameters())[list(_OUTPUTS), :], TS)
    _, y = control.forced_response(sampled, inputs=u)
    y = y.T + STD * rng.standard_normal((_N, 2))
    return Signals(u=u[:, None], y=y, Ts=TS, inputs=["u"], outputs=_OUTPUTS)


def emulated(seed: int, run: int) -> Signals:
    """Return a recording of the emulated rig, with its converter and its dead band."""
    with tempfile.TemporaryDirectory() as folder:
        rig = VirtualService(Config(), Path(folder), seed=1000 * seed + run)
        u = armrig.telegraph(_N, 0.05, seed=1000 * seed + run)
        path = rig.record(Run(lease=LEASE, n=0, u=u.tolist(), experiment="blackbox"))
        return armrig.load(path).signals()


def estimated(signals: Signals) -> dict[str, list[list[float]]]:
    """Return real and imaginary part of the pair, and the real pole, with their deviations."""
    data: Any = signals
    orders: Any = {"nb": [[4], [3]], "nf": 3, "integrator": "theta_1", "shared": "denominator"}
    fits = {
        "both": armrig.oe(data, **orders)["alpha", "u"],  # type: ignore[index]
        "theta_1": armrig.oe(
            signals.dataset("theta_1", "u"), nb=4, nf=4, integrator=True, starts="few"
        ),
        "alpha": armrig.oe(signals.dataset("alpha", "u"), nb=3, nf=3, starts="few"),
    }
    return {name: _poles(fit) for name, fit in fits.items()}


def _poles(fit: Any) -> list[list[float]]:
    roots, at = fit.poles(), truth()
    std = np.sqrt(np.maximum(np.diagonal(roots.covariance, axis1=1, axis2=2), 0.0))
    pair, real = (int(np.argmin(np.abs(roots.values - z))) for z in at)
    values = [roots.values[pair].real, roots.values[pair].imag, roots.values[real].real]
    return [values, [std[pair, 0], std[pair, 1], std[real, 0]]]


def summary(path: Path) -> None:
    """Print the scatter relative to theta_1 alone, and the coverage."""
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    pair, real = truth()
    z = np.array([pair.real, pair.imag, real.real])
    scatter: dict[str, Any] = {}
    for what in ("theta_1", "alpha", "both"):
        found = np.array([row[what] for row in rows if what in row])
        values, stds = found[:, 0], found[:, 1]
        var = np.var(values, axis=0, ddof=1)
        scatter[what] = np.sqrt([var[0] + var[1], var[2]])
        covered = 100 * np.mean(np.abs(values - z) < 1.96 * stds, axis=0)
        share = scatter[what] / scatter["theta_1"]
        print(
            f"{what:8} {len(found):5} runs  pair {share[0]:.3f}  real pole {share[1]:.3f}  covered "
            + " ".join(f"{x:.1f}" for x in covered)
        )


def main() -> None:
    """Append the runs that are missing, and print the summary."""
    parser = argparse.ArgumentParser()
    parser.add_argument("file", type=Path)
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--emulated", action="store_true")
    parser.add_argument("--summary", action="store_true")
    given = parser.parse_args()
    known = given.file.read_text(encoding="utf-8").splitlines() if given.file.exists() else []
    done = {json.loads(line)["run"] for line in known}
    made = emulated if given.emulated else simulated
    with given.file.open("a", encoding="utf-8") as file:
        for run in range(0 if given.summary else given.runs):
            if run not in done:
                row = {"run": run} | estimated(made(given.seed, run))
                print(json.dumps(row), file=file, flush=True)
    summary(given.file)


if __name__ == "__main__":
    main()
