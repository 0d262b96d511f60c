"""The unknown past of a model against its columns written out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.models.innovations import errors, forgotten, prepared, regression, response, unknown
from armrig.models.structure import Structure
from armrig.numerics.polynomial import Array, filtered

C, D, F = np.array([1.0, 0.5, 0.2]), np.array([1.0, -0.6]), np.array([1.0, -1.1, 0.4])
ONE = np.ones(1)


def data(N: int = 60) -> Dataset:
    """Return noise with three gaps; the first is near the start."""
    u, y = np.random.default_rng(1).standard_normal((2, N)) + 0.5
    valid = np.ones(N, dtype=bool)
    valid[[3, 4, 30, 31, 32, 34]] = False
    return Dataset(u=u, y=y, Ts=1.0, valid=valid)


CASES: list[tuple[dict[str, Any], Array, Array, Array]] = [
    ({"nb": 2, "nk": 1, "nc": 2, "nd": 1, "nf": 2}, C, D, F),
    ({"nb": 1, "nk": 3, "nf": 2, "offset": True}, ONE, ONE, F),
    ({"nb": 1, "nk": 1, "nc": 2, "nd": 1, "nf": 2, "integrator": "f"}, C, D, F),
    ({"nb": 1, "nk": 1, "na": 2, "nc": 2}, C, ONE, ONE),
    ({"nb": 1, "nk": 1, "nc": 2, "nd": 1, "nf": 2, "at_rest": True}, C, D, F),
]


def segments(valid: Any) -> list[tuple[int, int]]:
    """Return the begins and ends of the runs of measured samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], valid.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def columns(s: Structure, rows: Any, C: Array, D: Array, F: Array, part: Dataset) -> Array:
    """Return a column for each unknown: pulses of each segment, of the state, and the trend."""
    N = part.N
    found = []
    for begin, end in segments(part.valid) if s.nc else []:
        past = max(s.memory, s.first - begin)
        past = 0 if begin == 0 and s.at_rest else past
        if end - begin <= past:
            continue
        for k in range(past):
            pulse = np.eye(1, end - begin, k)[0]
            found.append(
                np.concatenate([np.zeros(begin), filtered([1.0], C, pulse), np.zeros(N - end)])
            )
    for k in range(s.count):
        found.append(filtered(D, np.convolve(C, F), np.eye(1, N, k)[0]))
    trend = [np.ones(N), np.arange(1.0, N + 1.0)][: s.trend]
    found += [filtered(D, C, x) for x in trend]
    if not found:
        return np.zeros((N, 0))
    return np.where(rows[:, None], np.column_stack(found), 0.0)


@pytest.mark.parametrize(("orders", "C", "D", "F"), CASES)
def test_the_unknown_past_is_projected_out_by_its_columns(
    orders: dict[str, Any], C: Array, D: Array, F: Array
) -> None:
    s, part = Structure(**orders), data()
    experiment = prepared(part, s)
    M = np.random.default_rng(2).standard_normal((part.N, 3)) * experiment.rows[:, None]

    found = unknown(experiment, s, C=C, D=D, F=F)

    X = columns(s, experiment.rows, C, D, F, part)
    expected = M - X @ np.linalg.lstsq(X, M, rcond=None)[0] if X.shape[1] else M
    np.testing.assert_allclose(found.without(M), expected, atol=1e-9)
    assert found.rank == (np.linalg.matrix_rank(X) if X.shape[1] else 0)
    np.testing.assert_allclose(found.span.T @ found.span, np.eye(found.rank), atol=1e-9)
    if X.shape[1]:
        np.testing.assert_allclose(found.span @ (found.span.T @ X), X, atol=1e-8)


@pytest.mark.parametrize(("orders", "C", "D", "F"), CASES)
def test_the_derivatives_of_the_errors_equal_finite_differences(
    orders: dict[str, Any], C: Array, D: Array, F: Array
) -> None:
    """Projected on the unknown past, de/dp for c, d and f, which the docstring has."""
    s, part = Structure(**orders), data()
    experiment = prepared(part, s)
    A = np.append(1.0, [-0.5, 0.1][: s.na])
    B = np.append(np.zeros(s.nk), [0.7, 0.3][: s.nb])

    def at(c: Array, d: Array, f: Array) -> Any:
        given = regression(experiment, s, C=c, D=d, F=f)
        return errors(experiment, s, given, A=A, B=B, C=c, D=d, F=f), given

    now, given = at(C, D, F)
    X = columns(s, experiment.rows, C, D, F, part)
    w = filtered(B, F, experiment.u)
    v = filtered(D, C, filtered(A, [1.0], experiment.y) - w) * experiment.rows
    expected = v - X @ np.linalg.lstsq(X, v, rcond=None)[0] if X.shape[1] else v
    np.testing.assert_allclose(now.e, expected, atol=1e-9)
    polynomials, k = [C, D, F], 0
    for i, p in enumerate(polynomials):
        for lag in range(1, p.size):
            ends = []
            for h in (1e-6, -1e-6):
                moved = [q.copy() for q in polynomials]
                moved[i][lag] += h
                ends.append(at(*moved)[0].e)
            slope = given.unknown.without((ends[0] - ends[1]) / 2e-6)
            np.testing.assert_allclose(now.Psi[:, k], -slope, atol=2e-3)
            k += 1
    assert k == now.Psi.shape[1]


def test_the_volume_of_the_unknown_past_has_its_gradient() -> None:
    """The logarithm of |Z^T Z| for the columns of each segment."""
    s, part = Structure(nb=1, nk=1, nc=2, nd=1, nf=2), data()
    experiment = prepared(part, s)

    def volumes(c: Array) -> list[tuple[float, Array]]:
        return [volume() for volume in unknown(experiment, s, C=c, D=D, F=F).volumes]

    found = volumes(C)

    lengths = [end - begin for begin, end in segments(part.valid) if end - begin > s.memory]
    assert len(found) == len(lengths)
    for n, (value, gradient), j in zip(lengths, found, range(9), strict=False):
        Z = np.column_stack([filtered([1.0], C, np.eye(1, n, k)[0]) for k in range(s.memory)])
        assert value == pytest.approx(np.log(np.linalg.det(Z.T @ Z)), abs=1e-9)
        for k in (0, 1):
            h = np.zeros(3)
            h[k + 1] = 1e-6
            slope = (volumes(C + h)[j][0] - volumes(C - h)[j][0]) / 2e-6
            assert gradient[k] == pytest.approx(slope, rel=1e-4, abs=1e-7)


def test_the_input_of_a_rig_at_rest_is_summed_from_zero() -> None:
    part = data()
    rest, moving = (
        Structure(nb=1, nk=1, nf=1, nd=2, integrator="f", at_rest=at_rest)
        for at_rest in (True, False)
    )

    np.testing.assert_allclose(prepared(part, rest).u, np.cumsum(part.u))
    np.testing.assert_allclose(prepared(part, moving).u, np.cumsum(part.u - part.u.mean()))
    assert [forgotten(rest, 0), forgotten(rest, 5)] == [0, 2]
    assert [forgotten(moving, 0), forgotten(moving, 5)] == [2, 2]
    late = Structure(nb=2, nk=3, na=2)
    assert [forgotten(late, start) for start in (0, 1, 2, 9)] == [4, 3, 2, 2]
    differenced = Structure(nb=1, nk=1, na=1, nc=1, integrator="a")
    y = prepared(part, differenced).y
    known = part.valid[1:] & part.valid[:-1]
    np.testing.assert_allclose(y[1:][known], np.diff(part.y)[known])


def test_an_impulse_response_is_truncated_after_its_decay() -> None:
    """A slow one is longer than 256 samples; a sum of lags ends with its last."""
    quick, slow = response([1.0], [1.0, -0.5], 5000), response([1.0], [1.0, -0.98], 5000)

    assert 55 <= quick.size <= 65
    np.testing.assert_allclose(quick, 0.5 ** np.arange(quick.size))
    assert 1900 <= slow.size <= 2300
    assert response([1.0, 2.0, 3.0], [1.0], 100).tolist() == [1.0, 2.0, 3.0]
    assert response([1.0], [1.0, -0.98], 300).size == 300
