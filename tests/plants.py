"""Simulated plants that are drawn by a seed, and the inputs that excite them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import armrig
import control
import numpy as np
from armrig import Dataset, Fit, Signals
from armrig.models.structure import Structure
from armrig.numerics.polynomial import apply_filter
from armrig.physics import ArmParameters
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Array = NDArray[Any]
Draw = np.random.Generator

LENGTHS = (300, 500, 1000, 2000, 4000)
FREQUENCIES = np.array([0.05, 0.2, 0.6, 1.5, 2.8])  # rad per sample
ARM_PARAMETERS = ("J_1", "J_2", "K_lin")
ARM_TS = 0.01
THETA_1_STD = 5e-3  # rad
NOISE_COVARIANCE = np.array([[1.0, 0.5], [0.5, 1.0]])
NOISE_SHARE = 0.1  # noise variance relative to the output's
_SETTLING = 200  # samples before the data
_BEFORE = 300


def polynomial(rng: Draw, order: int, *, slow: bool = True) -> Vector:
    """Return a monic polynomial whose roots are stable: resonant, slow real and fast real ones."""
    roots: list[complex] = []
    while len(roots) < order:
        kind = rng.choice(["pair", "slow", "fast"] if slow else ["pair", "fast"])
        if kind == "pair" and order - len(roots) >= 2:
            root = rng.uniform(0.5, 0.98) * np.exp(1j * rng.uniform(0.05, 2.9))
            roots += [root, root.conjugate()]
        elif kind == "slow":
            roots.append(1 - 10 ** rng.uniform(-2.3, -1))
        else:
            roots.append(rng.uniform(-0.7, 0.9))
    return np.real(np.poly(roots[:order])) if order else np.ones(1)


def _coloured(N: int, rng: Draw) -> Vector:
    """Return noise through a random filter with poles and zeros."""
    B, A = polynomial(rng, int(rng.integers(0, 3))), polynomial(rng, int(rng.integers(1, 4)))
    return apply_filter(B, A, rng.standard_normal(N))


def _twelve_sines(N: int, rng: Draw) -> Vector:
    """Return twelve sines of drawn frequencies and phases, without a common period."""
    w, phase = np.sort(rng.uniform(0.02, 3.0, 12)), rng.uniform(0, 2 * np.pi, 12)
    return np.asarray(np.cos(np.outer(np.arange(N), w) + phase).sum(axis=1))


def _multisine(N: int, rng: Draw) -> Vector:
    """Return a multisine of about thirty lines, repeated."""
    period = int(rng.integers(100, 400))
    lines = rng.choice(np.arange(1, period // 2), min(30, period // 2 - 1), replace=False)
    t = np.arange(N)[:, None]
    phase = rng.uniform(0, 2 * np.pi, lines.size)
    return np.asarray(np.cos(2 * np.pi * t * lines / period + phase).sum(axis=1))


def _chirp(N: int, rng: Draw) -> Vector:
    low, high = rng.uniform(0.005, 0.1), rng.uniform(0.5, 2.5)
    return np.asarray(np.cos(np.cumsum(np.linspace(low, high, N))))


INPUTS: dict[str, Callable[[int, Draw], Vector]] = {
    "telegraph": lambda N, rng: armrig.telegraph(N, rng.uniform(0.02, 0.4), 1.0, 4.0, seed=rng),
    "white": lambda N, rng: rng.standard_normal(N),
    "ARMA": _coloured,
    "multisine": _multisine,
    "12 sines": _twelve_sines,
    "chirp": _chirp,
    "steps": lambda N, rng: np.repeat(rng.uniform(0, 5, N // 25 + 1), 25)[:N],
}


def drawn_model(kind: str, rng: Draw) -> tuple[Dataset, Structure, Vector, str]:
    """Return data of OE, ARMAX or BJ, their structure, the true (c, d, f), and a description.

    Orders are 1 to 6. Poles are slow and fast, real and resonant. Zeros are inside and outside the
    unit circle. SNR is 0 to 40 dB.
    """
    name = str(rng.choice([*INPUTS]))
    N = int(rng.choice(LENGTHS))
    u = INPUTS[name](N, rng)
    n, nb, nk = int(rng.integers(1, 7)), int(rng.integers(1, 6)), int(rng.integers(0, 4))
    nc, nd = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    F, B = polynomial(rng, n), np.append(np.zeros(nk), rng.standard_normal(nb))
    C, D = polynomial(rng, nc), polynomial(rng, nd, slow=False)
    clean = apply_filter(B, F, u)
    noise = {"OE": ([1.0], [1.0]), "ARMAX": (C, F), "BJ": (C, D)}[kind]
    v = apply_filter(*noise, rng.standard_normal(N))
    level_db = float(rng.choice([0, 10, 20, 35, 40]))
    v *= np.std(clean) / np.std(v) * 10 ** (-level_db / 20)
    data = Dataset(u=u, y=clean + v, Ts=float(rng.choice([0.01, 0.1, 1.0])))
    truth = {"OE": F[1:], "ARMAX": C[1:], "BJ": np.concatenate([C[1:], D[1:], F[1:]])}[kind]
    orders = {
        "OE": Structure(nb=(nb,), nf=(n,), nk=(nk,)),
        "ARMAX": Structure(na=n, nb=(nb,), nc=nc, nf=(0,), nk=(nk,)),
        "BJ": Structure(nb=(nb,), nc=nc, nd=nd, nf=(n,), nk=(nk,)),
    }[kind]
    return data, orders, truth, f"{name}, N {N}, {level_db:g} dB"


def estimated_model(kind: str, data: Dataset, n: Structure) -> armrig.Fit:
    """Return the estimate of a drawn model."""
    (nb,), (nf,), (nk,) = n.nb, n.nf, n.nk
    if kind == "OE":
        return armrig.oe(data, nb=nb, nf=nf, nk=nk)
    if kind == "ARMAX":
        return armrig.armax(data, na=n.na, nb=nb, nc=n.nc, nk=nk)
    return armrig.bj(data, nb=nb, nc=n.nc, nd=n.nd, nf=nf, nk=nk)


@dataclass(frozen=True, slots=True, kw_only=True)
class DelayedPlant:
    """A plant B/F with a delay, half of them sampled from continuous time with a hold."""

    structure: tuple[int, int, int]
    """nb, nf and nk."""
    Ts: float
    u: Vector
    clean: Vector
    noise: Vector
    """Noise of the same power as `clean`."""

    def data(self, snr_db: float) -> Dataset:
        """Return the record with noise at this signal-to-noise ratio."""
        y = self.clean + self.noise * 10 ** (-snr_db / 20)
        return Dataset(u=self.u, y=y, Ts=self.Ts)


def delayed_plant(seed: int) -> DelayedPlant:
    """Return the plant of a seed: order 1 to 6, up to 20 samples of delay, any input of INPUTS."""
    rng = np.random.default_rng([seed, 28])
    n, integrator = int(rng.integers(1, 7)), bool(rng.random() < 0.3)
    if rng.random() < 0.5:
        B, F, Ts = _sampled_plant(rng, n, integrator=integrator)
    else:
        F = polynomial(rng, n - integrator)
        F = np.convolve(F, [1.0, -1.0]) if integrator else F
        B, Ts = rng.standard_normal(int(rng.integers(1, n + 1))), float(rng.choice([0.01, 0.1, 1]))
    nk = 1 + int(rng.integers(1, 21)) * int(rng.random() < 0.5)
    name, N = str(rng.choice(["PRBS", *INPUTS])), int(rng.choice(LENGTHS))
    u = INPUTS[name](N + _BEFORE, rng) if name != "PRBS" else _prbs(N + _BEFORE, rng)
    u = u - np.mean(u) if integrator else u
    clean = apply_filter(np.append(np.zeros(nk), B), F, u)[_BEFORE:]
    D = polynomial(rng, int(rng.integers(1, 3)), slow=False) if rng.random() < 0.5 else np.ones(1)
    v = apply_filter([1.0], D, rng.standard_normal(N + _BEFORE))[_BEFORE:]
    noise = float(np.std(clean) / np.std(v)) * v
    structure = (B.size, F.size - 1, nk)
    return DelayedPlant(structure=structure, Ts=Ts, u=u[_BEFORE:], clean=clean, noise=noise)


def _prbs(N: int, rng: Draw) -> Vector:
    return np.repeat(rng.choice([-1.0, 1.0], N), rng.integers(1, 5))[:N]


def _sampled_plant(rng: Draw, n: int, *, integrator: bool) -> tuple[Vector, Vector, float]:
    """Return B, F and Ts of a continuous plant with a hold."""
    degree = int(rng.integers(1, n + 1))
    poles: list[complex] = [0j] * integrator
    while len(poles) < n:
        if n - len(poles) >= 2 and rng.random() < 0.4:
            w, zeta = 10 ** rng.uniform(-0.3, 0.5), 10 ** rng.uniform(-1.5, -0.05)
            pole = w * complex(-zeta, np.sqrt(1 - zeta**2))
            poles += [pole, pole.conjugate()]
        else:
            poles.append(complex(-(10 ** rng.uniform(-0.1, 0.6))))
    zeros = -(10 ** rng.uniform(-0.3, 0.8, n - degree)) * rng.choice([1, 1, -1], n - degree)
    slowest = 1 / min([-p.real for p in poles if p] or [1.0])
    Ts = min(slowest * 10 ** rng.uniform(-1.7, -0.3), 2.5 / max(abs(p) for p in [*poles, 0.1]))
    H = control.ss2tf(control.sample_system(control.ss(control.zpk(zeros, poles, 1.0)), Ts, "zoh"))
    B, F = H.num[0][0], H.den[0][0]
    if integrator:
        F = np.convolve(np.polydiv(F, [1.0, -1.0])[0], [1.0, -1.0])
    return B[-n:], np.asarray(F), Ts


def drawn_arm(rng: Draw) -> ArmParameters:
    """Return the handout's arm with drawn inertias and stiffness."""
    p = ArmParameters()
    return replace(p, **{name: getattr(p, name) * rng.uniform(0.7, 1.4) for name in ARM_PARAMETERS})


def simulated_arm(rng: Draw, N: int, alpha_std: float) -> tuple[ArmParameters, Signals]:
    """Return drawn parameters, and signals of the arm with them: telegraph, 5 mrad on theta_1."""
    p = drawn_arm(rng)
    u = armrig.telegraph(N, 0.05, 0.0, 5.0, seed=rng)
    sampled = control.c2d(armrig.physics.arm(p)[["theta_1", "alpha"], :], ARM_TS)
    _, y = control.forced_response(sampled, inputs=u)
    y = y.T + rng.standard_normal((N, 2)) * [THETA_1_STD, alpha_std]
    names = {"inputs": ["u"], "outputs": ["theta_1", "alpha"], "units": ["rad", "rad"]}
    return p, Signals(u=u[:, None], y=y, Ts=ARM_TS, **names)


@dataclass(frozen=True, slots=True, kw_only=True)
class MultivariablePlant:
    """A drawn plant of several signals: its data, its estimate and its true values."""

    simulate: Callable[[Draw, int], tuple[Array, Array, dict[str, Any]]]
    """Returns u, y and the names of N samples."""
    fit: Callable[[Signals], Fit]
    theta: Array
    poles: Array
    G: Array
    """Frequency response at FREQUENCIES, (5, ny, nu)."""

    def signals(self, N: int, missing: float, run: tuple[int, ...]) -> Signals:
        """Return the data of one run, with a share of missing outputs."""
        rng = np.random.default_rng(run)
        u, y, names = self.simulate(rng, N + _SETTLING)
        y = y[_SETTLING:]
        valid = rng.random(y.shape) >= missing
        return Signals(u=u[_SETTLING:], y=y, Ts=1.0, valid=valid, **names)


def telegraphs(rng: Draw, N: int, nu: int) -> Array:
    """Return inputs of ±1 that change with probability 0.3."""
    return np.where(np.cumsum(rng.random((N, nu)) < 0.3, axis=0) % 2, 1.0, -1.0)


def drawn_poles(rng: Draw, n: int) -> Array:
    """Return n poles: pairs, and one real pole if n is odd."""
    z: list[complex] = []
    while len(z) + 1 < n:
        pole = rng.uniform(0.6, 0.92) * np.exp(1j * rng.uniform(0.2, 1.8))
        z += [pole, np.conj(pole)]
    return np.array([*z, *([rng.uniform(0.2, 0.85)] if len(z) < n else [])])


def response(B: Array, F: Array) -> Array:
    """Return B/F at FREQUENCIES."""
    x = np.exp(-1j * FREQUENCIES)
    return np.asarray(np.polyval(B[::-1], x) / np.polyval(F[::-1], x))


def chassis_and_arm(seed: int) -> MultivariablePlant:
    """Return a chassis with an integrator, and an arm: one input, one denominator."""
    rng = np.random.default_rng([seed, 2])
    F = np.real(np.poly(drawn_poles(rng, 3)))
    whole = np.convolve([1.0, -1.0], F)
    B = [np.append(0.0, rng.standard_normal(4)), np.append(0.0, rng.standard_normal(3))]

    def simulate(rng: Draw, N: int) -> tuple[Array, Array, dict[str, Any]]:
        u = telegraphs(rng, N, 1)
        clean = np.column_stack(
            [apply_filter(B[0], whole, u[:, 0]), apply_filter(B[1], F, u[:, 0])]
        )
        size = [np.std(apply_filter(B[0], F, u[:, 0])), np.std(clean[:, 1])]
        e = rng.standard_normal((N, 2)) @ np.linalg.cholesky(NOISE_COVARIANCE).T
        return u, clean + np.sqrt(NOISE_SHARE) * e * size, {"outputs": ["chassis", "arm"]}

    return with_one_denominator(simulate, B, F, "chassis")


def with_one_denominator(
    simulate: Callable[..., Any], B: list[Array], F: Array, integrator: str
) -> MultivariablePlant:
    """Return the plant of two outputs B/F, the first with an integrator."""
    whole = np.convolve([1.0, -1.0], F)
    orders: Any = {"nb": [[4], [3]], "nf": 3, "integrator": integrator, "shared": "denominator"}
    return MultivariablePlant(
        simulate=simulate,
        fit=lambda s: armrig.oe(s, **orders),
        theta=np.concatenate([B[0][1:], whole[1:], B[1][1:], F[1:]]),
        poles=np.roots(F),
        G=np.stack([response(B[0], whole), response(B[1], F)], axis=1)[:, :, None],
    )


def nonlinear_rig(kind: str, seed: int) -> Dataset:
    """Return a nonlinear rig of first order at random levels of u; the noise is 1 %."""
    rng = np.random.default_rng([seed, 51])
    u = np.repeat(rng.uniform(0, 5, 50), 16) - 2.5 * (kind == "friction")
    acts = {"dead zone": np.maximum(u - 1.2, 0), "gain by level": np.sqrt(abs(u))}.get(kind, u)
    x, still = np.zeros(u.size), 0.4 * (kind == "friction")
    for t in range(1, u.size):
        force = acts[t - 1] - x[t - 1]
        force -= still * np.sign(x[t - 1]) if x[t - 1] else np.clip(force, -still, still)
        x[t] = x[t - 1] + 0.2 * force
        x[t] *= not (still and x[t] * x[t - 1] < 0)
    y = x + 0.01 * np.std(x) * rng.standard_normal(u.size)
    return Dataset(u=u, y=np.minimum(y, 3.1) if kind == "saturation" else y, Ts=0.1)
