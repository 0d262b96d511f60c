"""The errors of a model with an unknown past, against the covariance matrix of its noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from armrig.models.innovations import errors, prepare, regression, response, volume
from armrig.models.structure import Structure
from armrig.numerics.polynomial import Array, apply_filter
from scipy.linalg import toeplitz

C, D, F = np.array([1.0, 0.5, 0.2]), np.array([1.0, -0.6]), np.array([1.0, -1.1, 0.4])
ONE = np.ones(1)
N = 60


def data(gaps: bool, nu: int = 2) -> tuple[Array, Array]:
    """Return noise u (N, nu) and y; with three gaps, the first is near the start."""
    u, y = np.random.default_rng(1).standard_normal((2, N, 2)) + 0.5
    y[[3, 4, 30, 31, 32, 34] if gaps else [], 0] = np.nan
    return u[:, :nu], y[:, 0]


CASES: list[tuple[dict[str, Any], Array, Array, list[Array]]] = [
    ({"nb": (2,), "nk": (1,), "nc": 2, "nd": 1, "nf": (2,)}, C, D, [F]),
    ({"nb": (1,), "nk": (3,), "nf": (2,), "offset": True}, ONE, ONE, [F]),
    ({"nb": (1,), "nk": (1,), "nc": 2, "nd": 1, "nf": (2,), "integrator": "f"}, C, D, [F]),
    ({"nb": (1,), "nk": (1,), "nf": (0,), "na": 2, "nc": 2}, C, ONE, [ONE]),
    ({"nb": (1,), "nk": (1,), "nf": (0,), "na": 2, "nd": 1}, ONE, D, [ONE]),
    ({"nb": (1,), "nk": (1,), "nc": 2, "nd": 1, "nf": (2,), "at_rest": True}, C, D, [F]),
    ({"nb": (2, 1), "nk": (1, 3), "nc": 2, "nd": 1, "nf": (2, 0)}, C, D, [F, ONE]),
    ({"nb": (2, 1), "nk": (0, 3), "nf": (2, 2), "nd": 1, "shared": True}, ONE, D, [F, F]),
]


def given_polynomials(s: Structure) -> dict[str, Any]:
    """Return A, and a B for each input."""
    A = np.append(1.0, [-0.5, 0.1][: s.na])
    pairs = zip(s.nk, s.nb, strict=True)
    return {"A": A, "B": [np.append(np.zeros(k), [0.7, 0.3][:n]) for k, n in pairs]}


def unknown_columns(s: Structure, A: Array, D: Array, F: list[Array]) -> Array:
    """Return the effect on y of each unknown: past of the noise, states, and the trend."""
    pulses = [np.eye(1, N, k)[0] for k in range(N)]
    past = 0 if s.at_rest else max(s.memory, s.first) if s.memory else 0
    found = [apply_filter([1.0], np.convolve(A, D), pulses[k]) for k in range(past)]
    for count, group in zip(s.counts, s.groups, strict=True):
        found += [apply_filter([1.0], np.convolve(A, F[group[0]]), pulses[k]) for k in range(count)]
    trend = [np.ones(N), np.arange(1.0, N + 1.0)][: s.trend]
    found += [apply_filter([1.0], A, x) for x in trend]
    return np.column_stack([np.zeros(N), *found])


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize(("orders", "C", "D", "F"), CASES)
def test_the_errors_are_those_of_generalised_least_squares(
    orders: dict[str, Any], C: Array, D: Array, F: list[Array], gaps: bool
) -> None:
    """By the covariance matrix of C/(D A) e at the measured samples, and all unknowns."""
    s = Structure(**orders)
    x = prepare(*data(gaps, len(s.nb)), s)
    p = given_polynomials(s)

    part = regression(x, s, A=p["A"], C=C, D=D, F=F, innovations=True)
    found = errors(x, s, part, **p, C=C, D=D, F=F)

    AD = np.convolve(p["A"], D)
    L = np.tril(toeplitz(apply_filter(C, AD, np.eye(1, N)[0])))[x.known]
    whiten = np.linalg.inv(np.linalg.cholesky(L @ L.T))
    w = sum(
        apply_filter(B, np.convolve(p["A"], f), u) for B, f, u in zip(p["B"], F, x.u.T, strict=True)
    )
    Z = whiten @ unknown_columns(s, p["A"], D, F)[x.known]
    v = whiten @ (x.y - w)[x.known]
    expected = v - Z @ np.linalg.lstsq(Z, v, rcond=1e-12)[0]
    np.testing.assert_allclose(found.e[x.known], expected, atol=1e-8)
    np.testing.assert_allclose(found.e[~x.known], 0.0, atol=1e-12)
    span = part.unknown.span
    np.testing.assert_allclose(span.T @ span, np.eye(part.unknown.rank), atol=1e-9)
    volume = 0.0 if part.noise is None else part.noise.log_scale
    assert volume == pytest.approx(np.linalg.slogdet(L @ L.T)[1], abs=1e-8)


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize(("orders", "C", "D", "F"), CASES)
def test_the_derivatives_of_the_errors_equal_finite_differences(
    orders: dict[str, Any], C: Array, D: Array, F: list[Array], gaps: bool
) -> None:
    """Projected on the unknown past, de/dp for a, c, d and f, in the order of the parameters."""
    s = Structure(**orders)
    x = prepare(*data(gaps, len(s.nb)), s)
    p = given_polynomials(s)

    def at(A: Array, c: Array, d: Array, *of_groups: Array) -> Any:
        f = [ONE] * len(s.nb)
        for group, q in zip(s.groups, of_groups, strict=True):
            for j in group:
                f[j] = q
        part = regression(x, s, A=A, C=c, D=d, F=f, innovations=True)
        return errors(x, s, part, A=A, B=p["B"], C=c, D=d, F=f), part

    polynomials = [p["A"], C, D, *(F[group[0]] for group in s.groups)]
    now, part = at(*polynomials)
    k = 0
    for i, q in enumerate(polynomials):
        for lag in range(1, q.size):
            ends = []
            for h in (1e-6, -1e-6):
                moved = [other.copy() for other in polynomials]
                moved[i][lag] += h
                ends.append(at(*moved))
            slope = part.unknown.without((ends[0][0].e - ends[1][0].e) / 2e-6)
            psi = part.unknown.without(now.Psi[:, k])
            np.testing.assert_allclose(psi, -slope, atol=2e-3)
            if part.noise is not None:
                scales = [end[1].noise.log_scale for end in ends]
                change = (scales[0] - scales[1]) / 2e-6
                assert now.by_scale[k] == pytest.approx(change, abs=1e-5)
            k += 1
    assert k == now.Psi.shape[1]


def test_the_volume_of_the_pulses_has_its_gradient() -> None:
    """The logarithm of |Z^T Z| for the pulses at the start, filtered by 1/C."""
    s = Structure(nb=(1,), nk=(1,), nc=2, nd=1, nf=(2,))
    x = prepare(*data(gaps=False, nu=1), s)

    value, gradient = volume(x, s, C)

    Z = np.column_stack([apply_filter([1.0], C, np.eye(1, N, k)[0]) for k in range(s.memory)])
    assert value == pytest.approx(np.log(np.linalg.det(Z.T @ Z)), abs=1e-9)
    for k in (0, 1):
        h = 1e-6 * np.eye(3)[k + 1]
        slope = (volume(x, s, C + h)[0] - volume(x, s, C - h)[0]) / 2e-6
        assert gradient[k] == pytest.approx(slope, rel=1e-4, abs=1e-7)


def test_the_input_of_a_rig_at_rest_is_summed_from_zero() -> None:
    """The mean of each input is subtracted if a ramp is estimated."""
    u, y = data(gaps=True)
    rest, moving = (
        Structure(nb=(1, 1), nk=(1, 1), nf=(1, 1), nd=2, integrator="f", at_rest=at_rest)
        for at_rest in (True, False)
    )

    np.testing.assert_allclose(prepare(u, y, rest).u, np.cumsum(u, axis=0))
    np.testing.assert_allclose(
        prepare(u, y, moving).u, np.cumsum(u - u.mean(axis=0), axis=0), atol=1e-12
    )
    assert [rest.past_pulse_count(0), rest.past_pulse_count(5)] == [0, 2]
    assert [moving.past_pulse_count(0), moving.past_pulse_count(5)] == [2, 2]
    late = Structure(nb=(2,), nk=(3,), nf=(0,), na=2)
    assert [late.past_pulse_count(start) for start in (0, 1, 2, 9)] == [4, 3, 2, 2]
    differenced = Structure(nb=(1,), nk=(1,), nf=(0,), na=1, nc=1, integrator="a")
    x = prepare(u[:, 0], y, differenced)
    known = np.isfinite(np.diff(y))
    np.testing.assert_allclose(x.y[1:][known], np.diff(y)[known])
    assert x.known.tolist() == [False, *known]


def test_an_impulse_response_is_truncated_after_its_decay() -> None:
    """A slow one is longer than 256 samples; a sum of lags ends with its last."""
    quick, slow = response([1.0], [1.0, -0.5], 5000), response([1.0], [1.0, -0.98], 5000)

    assert 55 <= quick.size <= 65
    np.testing.assert_allclose(quick, 0.5 ** np.arange(quick.size))
    assert 1900 <= slow.size <= 2300
    assert response([1.0, 2.0, 3.0], [1.0], 100).tolist() == [1.0, 2.0, 3.0]
    assert response([1.0], [1.0, -0.98], 300).size == 300
