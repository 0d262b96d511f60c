"""Drawn models and data of every shape, and judges of the residual tests and the predictions.

A case draws a structure, outputs, inputs, missing samples, the course of the input between samples
and an offset. The true structure is estimated, and judged on fresh data of its plant::

    python -m tests.drawn_shapes --seed 1 --count 1200

prints the share of the cases that each test rejects at 1 % and at 5 %. `conditional_means` computes
predictions by dense Gaussian conditioning, without a line of armrig.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import armrig
import numpy as np
from armrig.models.matrices import Matrices
from armrig.models.polynomials import Polynomials
from armrig.models.state_space import StateSpace
from armrig.models.transfer_function import TransferFunction
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import lfilter, lsim
from scipy.stats import norm

Array = NDArray[np.float64]
N, START, TS = 400, 300, 0.1
JUDGED = ("bj", "armax", "oe", "arx", "ss", "tf", "ararx", "process")
REPORTED = ("n4sid", "iv4", "greybox")
KINDS = (*JUDGED[:5] * 3, "tf", "tf", "ararx", "n4sid", "")
"""Structures of 20 successive cases; the last is in turn process, IV4 and grey box."""
ONE_OUTPUT = ("tf", "process", "iv4", "greybox")
WITH_OFFSET = ("bj", "armax", "oe", "tf", "process", "ararx")
TESTS = ("larger errors", "white", "dynamics", "feedback")


def kind_of(i: int) -> str:
    """Return the structure of case i."""
    return KINDS[i % len(KINDS)] or ("process", "iv4", "greybox")[i // len(KINDS) % 3]


def drawn_roots(rng: Generator, n: int, low: float = 0.3, high: float = 0.92) -> Array:
    """Return a monic polynomial of degree n with stable, distinct roots."""
    roots: list[complex] = []
    while len(roots) < n:
        size = rng.uniform(low, high)
        if n - len(roots) > 1 and rng.random() < 0.5:
            z = size * np.exp(1j * rng.uniform(0.3, 2.0))
            roots += [z, z.conjugate()]
        else:
            roots.append(size * (1 if rng.random() < 0.8 else -1))
    apart = [abs(a - b) for i, a in enumerate(roots) for b in roots[:i]]
    return (
        np.atleast_1d(np.real(np.poly(roots)))
        if min(apart, default=1) > 0.1
        else drawn_roots(rng, n)
    )


def drawn_zeros(rng: Generator, n: int, nk: int, F: Array) -> Array:
    """Return nk zeros and n coefficients whose roots are not near those of F, with the gain 1."""
    while True:
        b = np.append(1.0, rng.uniform(-0.8, 0.8, n - 1))
        apart = [abs(z - p) for z in np.roots(b) for p in np.roots(F)]
        if abs(b.sum()) > 0.2 and min(apart, default=1) > 0.25:
            return np.append(np.zeros(nk), b * F.sum() / b.sum())


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """Shape of a case."""

    kind: str
    """Structure."""
    ny: int
    """Number of outputs."""
    nu: int
    """Number of inputs."""
    mask: str
    """Pattern of the missing samples: none, samples, rows or bursts."""
    share: float
    """Share of missing samples."""
    hold: str
    """Course of the input between samples: zoh or foh; a discrete model then has nk = 0."""
    offset: bool
    """True if the outputs have levels, which are estimated."""


def drawn_shape(rng: Generator, kind: str) -> Shape:
    """Return the shape of a case: half have two outputs, and three quarters have gaps."""
    ny = 1 if kind in ONE_OUTPUT else 1 + int(rng.random() < 0.6)
    return Shape(
        kind=kind,
        ny=ny,
        nu=1 if kind in ONE_OUTPUT else 1 + int(rng.random() < 0.3),
        mask=str(rng.choice(["none", "samples", "rows", "bursts"])),
        share=float(rng.uniform(0.02, 0.3)),
        hold="foh" if rng.random() < 0.3 and kind != "iv4" else "zoh",
        offset=kind in WITH_OFFSET and rng.random() < 0.3,
    )


def drawn_mask(rng: Generator, shape: Shape, n: int) -> NDArray[np.bool_]:
    """Return a mask (n, ny), False where a sample is missing."""
    if shape.mask == "none":
        return np.ones((n, shape.ny), dtype=bool)
    if shape.mask == "samples":
        return rng.random((n, shape.ny)) >= shape.share
    if shape.mask == "rows":
        return np.repeat(rng.random((n, 1)) >= shape.share, shape.ny, axis=1)
    valid = np.ones((n, shape.ny), dtype=bool)
    while np.mean(valid) > 1 - shape.share:
        begin, i = int(rng.integers(n)), int(rng.integers(shape.ny))
        valid[begin : begin + int(rng.integers(3, max(n // 20, 5))), i] = False
    return valid


@dataclass(frozen=True, slots=True, kw_only=True)
class Plant:
    """Plant of a case: its outputs, and the estimator with its true orders."""

    respond: Callable[[Array, Array], Array]
    """Function of the inputs (n, nu) and white noise (n, ny) that returns the outputs (n, ny)."""
    estimate: Callable[[Any], Any]
    """Function that estimates the model of data with the true orders."""
    form: Any = None
    """True model, for predictions."""
    truth: dict[str, float] | None = None
    """True parameters of a grey box."""


def drawn_plant(rng: Generator, shape: Shape) -> Plant:
    """Return a plant of the structure, with a gain of 1 from each input to each output."""
    if shape.kind in ("ss", "n4sid"):
        return _of_states(rng, shape)
    if shape.kind in ("tf", "process", "greybox"):
        return _of_s(rng, shape)
    return _of_rows(rng, shape)


def _of_rows(rng: Generator, shape: Shape) -> Plant:
    """Return a plant of polynomials: a row for each output; the rows of ARX affect each other."""
    kind, ny, nu = shape.kind, shape.ny, shape.nu
    nk = 0 if shape.hold == "foh" else int(rng.integers(1, 4))
    by_a, by_f = kind in ("arx", "ararx", "armax", "iv4"), kind in ("oe", "bj")
    nc = int(rng.integers(1, 3)) if kind in ("armax", "bj") else 0
    nd = int(rng.integers(1, 3)) if kind in ("ararx", "bj") else 0
    n, nb = int(rng.integers(1, 3)), int(rng.integers(1, 3))
    A = [drawn_roots(rng, n if by_a else 0) for _ in range(ny)]
    F = [[drawn_roots(rng, n if by_f else 0) for _ in range(nu)] for _ in range(ny)]
    B = [[drawn_zeros(rng, nb, nk, A[i] if by_a else f) for f in F[i]] for i in range(ny)]
    C = [drawn_roots(rng, nc, 0.2, 0.7) for _ in range(ny)]
    D = [drawn_roots(rng, nd, 0.2, 0.9) for _ in range(ny)]
    cross = rng.uniform(-0.3, 0.3, 2) if kind == "arx" and ny == 2 else np.zeros(2)

    def respond(u: Array, e: Array) -> Array:
        driven = np.zeros((len(u), ny))
        for i in range(ny):
            driven[:, i] = sum(lfilter(B[i][j], F[i][j], u[:, j]) for j in range(nu))
            driven[:, i] += lfilter(C[i], D[i], e[:, i])
        if not cross.any():
            return np.column_stack([lfilter([1.0], A[i], driven[:, i]) for i in range(ny)])
        y = np.zeros((len(u) + n, ny))
        for t in range(len(u)):
            past = y[t : t + n][::-1]
            for i in range(ny):
                y[t + n, i] = driven[t, i] - A[i][1:] @ past[:, i] - cross[i] * past[0, 1 - i]
        return y[n:]

    options: dict[str, Any] = {} if kind in ("arx", "iv4") else {"starts": "few"}
    options |= {"offset": True} if shape.offset else {}
    orders: dict[str, Any] = {"nb": [[nb] * nu] * ny if (ny, nu) != (1, 1) else nb, "nk": nk}
    if by_a:
        orders["na"] = n
        if ny == 2 and kind == "arx":
            orders["na"] = [[n, 1], [1, n]]
    orders |= {"nc": nc} if nc else {}
    orders |= {"nd": nd} if nd else {}
    orders |= {"nf": n} if by_f else {}
    zero = np.zeros(1)
    couplings = [np.array([0.0, c]) if cross.any() else zero for c in cross]
    form = Polynomials(
        A=tuple(tuple(A[i] if i == k else couplings[i] for k in range(ny)) for i in range(ny)),
        B=tuple(map(tuple, B)),
        C=tuple(C),
        D=tuple(D),
        F=tuple(map(tuple, F)),
        nk=((nk,) * nu,) * ny,
        integrators=(False,) * ny,
    )
    if np.max(np.abs(np.linalg.eigvals(form.innovations_form().A)), initial=0) > 0.95:
        return _of_rows(rng, shape)
    return Plant(
        respond=respond,
        estimate=lambda data: getattr(armrig, kind)(data, **orders, **options),
        form=form,
    )


def _of_states(rng: Generator, shape: Shape) -> Plant:
    """Return a plant in innovations form."""
    n, ny, nu = int(rng.integers(max(shape.ny, 1), 4)), shape.ny, shape.nu
    direct = shape.hold == "foh"
    while True:
        f = drawn_roots(rng, n)
        T = rng.standard_normal((n, n))
        A = np.linalg.solve(T, (np.eye(n, k=1) - f[1:, None] * np.eye(1, n)) @ T)
        B, C = rng.standard_normal((n, nu)), rng.standard_normal((ny, n))
        K = 0.3 * rng.standard_normal((n, ny))
        D = rng.standard_normal((ny, nu)) if direct else np.zeros((ny, nu))
        seen = np.vstack([C @ np.linalg.matrix_power(A, k) for k in range(n)])
        led = np.hstack([np.linalg.matrix_power(A, k) @ np.hstack([B, K]) for k in range(n)])
        fast = np.max(np.abs(np.linalg.eigvals(A - K @ C))) < 0.85
        if fast and max(np.linalg.cond(seen), np.linalg.cond(led)) < 20:
            break

    def respond(u: Array, e: Array) -> Array:
        x, y = np.zeros(n), np.zeros((len(u), ny))
        for t in range(len(u)):
            y[t] = C @ x + D @ u[t] + e[t]
            x = A @ x + B @ u[t] + K @ e[t]
        return y

    nk = 0 if direct else 1

    def estimate(data: Any) -> Any:
        if shape.kind == "ss":
            return armrig.ss(data, order=n, nk=nk)
        return armrig.n4sid(data, n, nk=nk, replicates=20)

    form = Matrices(A=A, B=B, C=C, D=D, K=K, nk=(nk,) * nu)
    return Plant(respond=respond, estimate=estimate, form=form)


def _of_s(rng: Generator, shape: Shape) -> Plant:
    """Return a plant in s, with white or coloured noise in discrete time."""
    second = shape.kind == "tf" and rng.random() < 0.6
    poles = -rng.uniform(0.5, 4.0, 2) if rng.random() < 0.5 else -1.5 + 4j * np.array([1, -1])
    poles = poles if second else -rng.uniform(0.5, 4.0, 1)
    F = np.real(np.poly(poles))
    noise = (0, 0) if shape.kind == "greybox" or rng.random() < 0.5 else (1, 1)
    C, D = (drawn_roots(rng, k, 0.2, 0.8) for k in noise)

    def respond(u: Array, e: Array) -> Array:
        t = TS * np.arange(len(u))
        y = lsim(([F[-1]], F), u[:, 0], t, interp=shape.hold == "foh")[1]
        return np.reshape(y, (-1, 1)) + lfilter(C, D, e, axis=0)

    def estimate(data: Any) -> Any:
        if shape.kind == "tf":
            return armrig.tf(data, poles=F.size - 1, zeros=0, noise=noise, offset=shape.offset)
        if shape.kind == "process":
            return armrig.process(data, "P1", noise=noise, offset=shape.offset)
        model = armrig.Ode(
            lambda t, x, u, p: [p.k * u[0] - p.a * x[0]],
            output=lambda t, x, u, p: x[0],
            states=["x"],
            parameters={name: armrig.Parameter(1.5 * F[-1], low=0) for name in "ka"},
        )
        return armrig.greybox(data, model)

    form = TransferFunction(
        B=((F[-1:],),),
        F=((F,),),
        C=(C,),
        D=(D,),
        Ts=TS,
        hold="foh" if shape.hold == "foh" else "zoh",
    )
    truth = {"k": F[-1], "a": F[-1]} if shape.kind == "greybox" else None
    return Plant(respond=respond, estimate=estimate, form=form, truth=truth)


def measured(rng: Generator, shape: Shape, plant: Plant, size: float, cross: float) -> Any:
    """Return N samples of the plant; e has the deviation `size` and the correlation `cross`."""
    whole = N + START
    u = np.cumprod(np.where(rng.random((whole, shape.nu)) < 0.25, -1.0, 1.0), axis=0)
    e = size * rng.standard_normal((whole, shape.ny))
    if shape.ny == 2:
        e[:, 1] = cross * e[:, 0] + np.sqrt(1 - cross**2) * e[:, 1]
    y = plant.respond(u, e)[START:] + (2.0 if shape.offset else 0.0)
    valid = drawn_mask(rng, shape, N)
    given = {"intersample": shape.hold} if shape.kind in ONE_OUTPUT else {}
    data = armrig.Signals(u=u[START:], y=y, Ts=TS, valid=valid, **given)
    return data.dataset() if (shape.ny, shape.nu) == (1, 1) else data


def judged(seed: int, i: int) -> tuple[Shape, dict[str, float], str]:
    """Return the shape of a case, the p values of its right model on fresh data, and a doubt.

    The doubt is the reason why armrig says that its tests find nothing, or "".
    """
    rng = np.random.default_rng([seed, i])
    shape = drawn_shape(rng, kind_of(i))
    plant = drawn_plant(rng, shape)
    size, cross = float(rng.uniform(0.05, 0.3)), float(rng.choice([0.0, 0.5]))
    own, fresh = (measured(rng, shape, plant, size, cross) for _ in range(2))
    model = plant.estimate(own)
    if plant.truth is not None:
        z = [(model.values[k] - true) / model.std_robust[k] for k, true in plant.truth.items()]
        return shape, {f"parameter {k}": 2 * norm.sf(abs(v)) for k, v in enumerate(z)}, ""
    r = armrig.residuals(model, fresh)
    p = r.larger_errors, r.white.p_value, r.missing_dynamics, r.feedback
    return shape, dict(zip(TESTS, map(float, p), strict=True)), r.powerless or r.blind


_OTHER_SEED = 1_000_003  # from a case that rounding errors decide to its substitute


class RoundingDecidesError(Exception):
    """The data hardly show a state, so that rounding errors decide on its estimate."""


def conditional_means(
    system: StateSpace, Lambda: Array, data: Any, horizon: int, levels: bool
) -> tuple[Array, NDArray[np.bool_]]:
    """Return E[y(t) | y to t - horizon] for the most probable x(0), and where data determine it.

    The outputs are one Gaussian vector without its missing samples.
    """
    A, B, C, D, K = system.A, system.B, system.C, system.D, system.K
    (size, ny), n = data.y.shape, len(A)
    f, M = np.zeros((size, ny)), np.zeros((size, ny, n + ny * levels))
    H = np.zeros((size, ny, size, ny))
    x, X, E = np.zeros(n), np.eye(n), np.zeros((n, size, ny))
    for t in range(size):
        f[t], M[t, :, :n], H[t] = C @ x + D @ data.u[t], C @ X, np.tensordot(C, E, 1)
        H[t, range(ny), t, range(ny)] += 1
        M[t, :, n:] = np.eye(ny)[:, : ny * levels]
        x, X, E = A @ x + B @ data.u[t], A @ X, np.tensordot(A, E, 1)
        E[:, t] += K
    whole = H.reshape(size * ny, -1)
    S = whole @ np.kron(np.eye(size), Lambda) @ whole.T
    f, M = f.ravel(), M.reshape(size * ny, -1)
    o = np.flatnonzero(data.valid.ravel())
    root = np.linalg.cholesky(S[np.ix_(o, o)])
    white = np.linalg.solve(root, M[o])
    scale = np.maximum(np.linalg.norm(white, axis=0), 1e-12)
    U, s, V = np.linalg.svd(white / scale, full_matrices=False)
    kept = s > 1e-6 * s[0]
    if np.any((s > 1e-10 * s[0]) & (s < 1e-4 * s[0])):
        raise RoundingDecidesError
    v = np.linalg.solve(root, data.y.ravel()[o] - f[o])
    found = (V[kept].T @ ((U.T @ v)[kept] / s[kept])) / scale
    free = np.linalg.svd(V[kept])[2][int(kept.sum()) :]  # combinations that the data do not show
    left = data.y.ravel()[o] - f[o] - M[o] @ found
    means, determined = np.zeros(size * ny), np.zeros(size * ny, dtype=bool)
    for k in range(size * ny):
        p = o[o < (k // ny - horizon + 1) * ny]
        gain = np.linalg.solve(S[np.ix_(p, p)], S[p, k])
        means[k] = f[k] + M[k] @ found + gain @ left[: p.size]
        effect = (M[k] - gain @ M[p]) / scale
        determined[k] = np.abs(free @ effect).max(initial=0) < 1e-7
    return means.reshape(size, ny), determined.reshape(size, ny)


def prediction_error(seed: int, i: int) -> tuple[Shape, float, float]:
    """Return a shape, the largest error of its predictions over std(y), and their least share.

    The model is the true one, and N at most 60. The share is that of the predictions that are
    numbers and that the data determine.
    """
    rng = np.random.default_rng([seed, i])
    while True:
        shape = drawn_shape(rng, kind_of(i))
        plant = drawn_plant(rng, shape)
        system = plant.form.innovations_form()
        if shape.kind != "greybox" and system.order <= 12:
            break
        i += 1
    size, ny, nu = int(rng.integers(30, 61)), shape.ny, shape.nu
    joint = shape.kind in ("ss", "n4sid", "arx")
    cross = 0.5 if joint else 0.0
    Lambda = 0.04 * (np.eye(ny) + cross * (1 - np.eye(ny)))
    u = np.sign(rng.standard_normal((size, nu)))
    e = rng.standard_normal((size, ny)) @ np.linalg.cholesky(Lambda).T
    x, y = rng.standard_normal(system.order), np.zeros((size, ny))
    for t in range(size):
        y[t] = system.C @ x + system.D @ u[t] + e[t] + shape.offset
        x = system.A @ x + system.B @ u[t] + system.K @ e[t]
    data = armrig.Signals(u=u, y=y, Ts=TS, valid=drawn_mask(rng, shape, size))
    d = plant.form.theta.size
    model = armrig.Fit(
        structure="arx" if shape.kind == "arx" else "model",
        form=plant.form,
        inputs=data.inputs,
        outputs=data.outputs,
        input_units=("",) * nu,
        units=("",) * ny,
        Ts=0.0 if isinstance(plant.form, TransferFunction) else TS,
        offset=shape.offset,
        covariance=np.zeros((d, d)),
        covariance_robust=np.zeros((d, d)),
        noise_covariance=Lambda,
    )
    worst, least = 0.0, 1.0
    for horizon in (1, int(rng.integers(2, 8))):
        found = model.predict(data, horizon).reshape(size, ny)
        try:
            expected, determined = conditional_means(system, Lambda, data, horizon, shape.offset)
        except RoundingDecidesError:
            return prediction_error(seed + _OTHER_SEED, i)
        both = np.isfinite(found) & determined
        worst = max(worst, float(np.abs(found - expected)[both].max() / np.nanstd(y)))
        least = min(least, float(np.mean(both)))
    return shape, worst, least


def main() -> None:
    """Print the share of right models that each test rejects, for all cases and each structure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=1200)
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    p: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    started, doubts = time.process_time(), 0
    for i in range(asked.count):
        shape, values, doubt = judged(asked.seed, i)
        doubts += bool(doubt)
        if min(values.values()) < 1e-4:
            print(f"case {i}: {shape}: { {k: f'{v:.1e}' for k, v in values.items()} }", flush=True)
        mine = [shape.kind, f"{shape.kind} {shape.ny} {shape.mask}"]
        for name in mine + ["all"] * (shape.kind in JUDGED):
            for test, value in values.items():
                p[name][test].append(value)
    for name in sorted(p):
        for test, values_ in p[name].items():
            v = np.array(values_)
            v = v[np.isfinite(v)]
            shares = f"{np.mean(v < 0.01):7.1%} at 1 % {np.mean(v < 0.05):7.1%} at 5 %"
            print(f"{name:22} {test:14} n {v.size:4} {shares}")
    spent = (time.process_time() - started) / 60
    print(f"doubted by armrig: {doubts} of {asked.count}; {spent:.1f} min of processor time")


if __name__ == "__main__":
    main()
