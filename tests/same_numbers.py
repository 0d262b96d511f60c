"""Print what the estimators make of fixed data, as JSON; with a file of it, compare to 1e-9.

`python tests/same_numbers.py > before.json`, and after a change `python tests/same_numbers.py
before.json`: it prints the worst difference of each model and exits with 1 above 1e-9. Only public
names are called, so it runs in any release's environment. Both runs belong on one machine: another
BLAS may round otherwise, and a search ends elsewhere within its tolerance.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import armrig
import numpy as np
from armrig_core.arm import ArmParameters, arm_matrices, chassis_matrices, zero_order_hold
from numpy.typing import NDArray

Vector = NDArray[np.float64]
WITHIN = 1e-9
_FIT = ("theta", "std", "std_robust", "noise_variance", "loss", "fit_percent", "whiteness")
_GREY = ("covariance", "covariance_robust", "noise_variance", "loss", "fit_percent", "whiteness")
_TESTS = ("autocorrelation", "cross_correlation", "whiteness", "ljung_box", "missing_dynamics")
_IMPULSE = ("g", "covariance", "noise_variance", "whiteness")
_SPECTRUM = ("omega", "std_magnitude", "std_phase", "noise_spectrum", "coherence")


def main() -> int:
    """Print, or compare."""
    found = {name: _plain(value) for name, value in numbers()}
    if len(sys.argv) < 2:
        print(json.dumps(found, indent=1))
        return 0
    before = json.loads(Path(sys.argv[1]).read_text())
    if before.keys() != found.keys():
        print(f"other models than in {sys.argv[1]}: {before.keys() ^ found.keys()}")
        return 1
    worst = 0.0
    for name, parts in found.items():
        off = {part: difference(parts[part], before[name][part]) for part in before[name]}
        part = max(off, key=lambda part: off[part])
        print(f"{name:28} {off[part]:8.1e}  {part}")
        worst = max(worst, off[part])
    print(f"{'worst':28} {worst:8.1e}  {'more' if worst > WITHIN else 'not more'} than {WITHIN:g}")
    return int(worst > WITHIN)


def difference(found: Any, before: Any) -> float:
    """Return the largest difference of two arrays, in parts of the largest number before."""
    a, b = (np.atleast_1d(np.array(x, dtype=np.float64)) for x in (found, before))
    if a.shape != b.shape or not np.array_equal(np.isfinite(a), np.isfinite(b)):
        return np.inf
    known = np.isfinite(b)
    if not known.any():
        return 0.0
    scale = float(np.max(np.abs(b[known])))
    return float(np.max(np.abs(a[known] - b[known]))) / (scale or 1.0)


def numbers() -> Iterator[tuple[str, dict[str, Any]]]:
    """Give each model's numbers by name."""
    whole, fresh = arm_data(1), arm_data(2)
    holed = whole.replaced(step=None, valid=np.arange(whole.N) % 250 > 6)
    two = armrig.merge([arm_data(4, 700), arm_data(5, 900)])
    for kind, data in {"": whole, " holes": holed, " two": two}.items():
        for name, estimate in ESTIMATORS.items():
            fit = estimate(data)
            poles = np.asarray(fit.poles())
            parts = {part: getattr(fit, part) for part in _FIT}
            yield name + kind, parts | {"poles": [poles.real, poles.imag]}
    fit = ESTIMATORS["oe"](whole)
    judged = {"residuals": whole, "residuals fresh": fresh, "residuals holes": holed}
    for name, data in judged.items():
        yield name, _parts(armrig.residuals(fit, data), _TESTS)
    yield "compare", {"predicted": fit.predict(fresh), "simulated": fit.simulate(fresh.u)}
    for kernel in ("tc", None):
        impulse = armrig.impulse_response(holed, kernel=kernel)
        yield f"impulse {kernel}", _parts(impulse, _IMPULSE)
    G = armrig.spa(whole)
    yield "spa", _parts(G, _SPECTRUM) | {"G": [G.G.real, G.G.imag]}
    table = armrig.select_orders(holed, range(1, 5), range(1, 5), range(1, 3), validation=fresh)
    yield "select_orders", _parts(table, ("loss", "validation_loss", "batch_losses"))
    for name, grey in {
        "greybox": armrig.greybox(chassis_data(1)),
        "greybox friction": armrig.greybox(chassis_data(1), friction="viscous"),
        "greybox fixed_std": armrig.greybox(chassis_data(2), fixed_std={"R_m": 0.03}),
        "greybox arm": armrig.greybox(whole, armrig.arm, ("J_1", "J_2")),
        "inverse_dynamics": armrig.inverse_dynamics(chassis_data(1)),
    }.items():
        values = [grey.values[name] for name in grey.names]
        yield name, _parts(grey, _GREY) | {"values": values}


ESTIMATORS: dict[str, Callable[[armrig.Dataset], armrig.Fit]] = {
    "arx": lambda data: armrig.arx(data, na=4, nb=4),
    "armax": lambda data: armrig.armax(data, na=4, nb=4, nc=2),
    "oe": lambda data: armrig.oe(data, nb=4, nf=4),
    "oe integrator": lambda data: armrig.oe(data, nb=4, nf=4, integrator=True),
    "oe offset": lambda data: armrig.oe(data, nb=4, nf=4, integrator=True, offset=True),
    "bj": lambda data: armrig.bj(data, nb=4, nc=1, nd=1, nf=4, integrator=True),
    "pem": lambda data: armrig.pem(data, nb=2, na=1, nc=1, nf=3),
    "iv4": lambda data: armrig.iv4(data, na=4, nb=4),
    "n4sid": lambda data: armrig.n4sid(data, 4),
    "n4sid integrator": lambda data: armrig.n4sid(data, 4, integrator=True),
}


def arm_data(seed: int, N: int = 1500) -> armrig.Dataset:
    """Return theta_1 of the handout's arm at 10 ms, with coloured noise."""
    A, B, C = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, 0.01)
    return _observed(Phi, Gamma[:, 0], C[0], seed, N, 0.01, 5e-3)


def chassis_data(seed: int) -> armrig.Dataset:
    """Return theta_1 of the chassis alone at 2 ms."""
    A, B, C = chassis_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, 0.002)
    return _observed(Phi, Gamma[:, 0], C[0], seed, 4000, 0.002, 2e-3)


def _observed(
    Phi: NDArray[np.float64], Gamma: Vector, c: Vector, seed: int, N: int, Ts: float, std: float
) -> armrig.Dataset:
    rng = np.random.default_rng([seed, 12])
    u = 0.5 + 4.0 * (np.cumsum(rng.random(N) < 5 * Ts) % 2)
    x, y = np.zeros(Gamma.size), np.empty(N)
    e = rng.standard_normal(N)
    for k in range(N):
        y[k] = c @ x + std * (e[k] + 0.5 * e[k - 1])
        x = Phi @ x + Gamma * u[k]
    return armrig.Dataset(u=u, y=y, Ts=Ts, output="theta_1", unit="rad")


def _parts(value: Any, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: getattr(value, name) for name in names if getattr(value, name) is not None}


def _plain(parts: dict[str, Any]) -> dict[str, Any]:
    """Return arrays as lists; what is not finite as None."""
    return {name: _listed(np.array(value, dtype=np.float64)) for name, value in parts.items()}


def _listed(array: NDArray[np.float64]) -> Any:
    flat = [x if np.isfinite(x) else None for x in array.ravel().tolist()]
    return np.array(flat, dtype=object).reshape(array.shape).tolist()


if __name__ == "__main__":
    sys.exit(main())
