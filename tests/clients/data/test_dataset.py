"""A Dataset cannot exist in a bad state, and never hides a gap."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from hypothesis import given
from hypothesis import strategies as st
from matplotlib import pyplot as plt


def ramp(N: int, **others: object) -> Dataset:
    """Return a Dataset whose numbers are their places."""
    n = np.arange(float(N))
    return Dataset(u=n, y=-n, Ts=0.1, **others)  # type: ignore[arg-type]


def test_the_arrays_are_read_only_copies() -> None:
    u = np.zeros(3)

    data = Dataset(u=u, y=[1, 2, 3], Ts=0.1)
    u[0] = 9.0

    assert data.u[0] == 0.0
    assert data.y.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        data.y[0] = 1.0


def test_a_missing_output_reads_nan_whatever_it_was() -> None:
    """A formula that used the value would give nan."""
    data = Dataset(u=[0, 0, 0], y=[1, 2, 3], Ts=1, valid=[True, False, True])

    assert np.isnan(data.y[1])
    assert data.missing == 1


def test_what_is_masked_is_missing() -> None:
    y = np.ma.masked_array([1.0, 1e6, np.nan, 4.0], mask=[False, True, True, False])

    data = Dataset(u=np.zeros(4), y=y, Ts=1, valid=[False, True, True, True])

    np.testing.assert_array_equal(data.y, [np.nan, np.nan, np.nan, 4.0])
    assert data.valid.tolist() == [False, False, False, True]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"y": [1.0, 2.0]}, "u has 3 samples and y has 2"),
        ({"u": [0.0, np.nan, 0.0]}, "u is not finite at 1 samples, first nan at 1"),
        ({"y": [0.0, 1.0, np.inf]}, "first inf at 2; mark them missing, valid=numpy.isfinite"),
        ({"Ts": 0.0}, "Ts=0.0 must be finite and > 0"),
        ({"valid": [True]}, r"valid has shape \(1,\)"),
        ({"u": [[1.0, 2.0, 3.0]]}, r"u has shape \(1, 3\).*ravel"),
        ({"starts": (0, 3)}, r"starts=\(0, 3\) must begin with 0 and rise strictly, below N=3"),
        ({"starts": (1,)}, "must begin with 0"),
        (
            {"y": np.array([0, 1j, 2])},
            r"y is complex \(complex128\), but must be real",
        ),
        ({"u": [0.0, 1.0 + 0j, 2.0]}, "u is complex"),
        (
            {"u": np.ma.masked_equal([0.0, 1.0, 2.0], 1.0)},
            "u is not finite at 1 samples.*cut these",
        ),
    ],
)
def test_a_bad_state_is_refused(arguments: dict[str, object], message: str) -> None:
    good = {"u": [0.0, 1.0, 2.0], "y": [0.0, 1.0, 2.0], "Ts": 0.1}

    with pytest.raises(ValueError, match=message):
        Dataset(**(good | arguments))  # type: ignore[arg-type]


@given(st.integers(1, 40), st.integers(1, 40))
def test_the_parts_of_a_split_join_to_the_whole(N: int, k: int) -> None:
    if k > N:
        with pytest.raises(ValueError, match=f"into {k} parts: 1 to {N} are possible"):
            ramp(N).split(k)
        return

    parts = ramp(N).split(k)

    np.testing.assert_array_equal(np.concatenate([p.u for p in parts]), np.arange(N))
    assert max(p.N for p in parts) - min(p.N for p in parts) <= 1


def test_experiments_come_back_from_a_merge_as_they_went_in() -> None:
    first, second = ramp(4, valid=[True, True, False, True]), ramp(3)

    parts = list(merge([first, second]).experiments())

    assert [p.N for p in parts] == [4, 3]
    np.testing.assert_array_equal(parts[0].valid, first.valid)
    np.testing.assert_array_equal(parts[1].y, second.y)


def test_a_slice_keeps_the_boundaries_inside_it() -> None:
    data = merge([ramp(4), ramp(4), ramp(4)])

    assert data[2:10].starts == (0, 2, 6)
    assert data[4:8].starts == (0,)


def test_only_a_slice_without_a_step_cuts() -> None:
    """A step would change the sampling time, which a slice does not know."""
    with pytest.raises(TypeError, match="cut with data"):
        ramp(4)[::2]
    with pytest.raises(ValueError, match="is empty: there are 4 samples"):
        ramp(4)[4:9]


def test_what_differs_cannot_be_merged() -> None:
    with pytest.raises(
        ValueError, match=r"merge needs the same unit in all data, got \['deg', 'rad'\]"
    ):
        merge([ramp(3, unit="rad"), ramp(3, unit="deg")])


def test_the_history_has_every_cut() -> None:
    whole = ramp(10, history=("recorded",))

    merged = merge([whole[0:4], whole[4:10]])

    assert merged.history == (
        "recorded",
        "part 1: took samples 0 to 3 of 10",
        "part 2: took samples 4 to 9 of 10",
        "merged 2 parts of 4, 6 samples",
    )
    assert whole[:].history == merge([whole]).history == ("recorded",)
    with pytest.raises(AttributeError):
        merged.history.append("no")  # type: ignore[attr-defined]


def test_experiments_are_selected_by_their_numbers() -> None:
    data = merge([ramp(2), ramp(3, valid=[True, False, True]), ramp(4)])

    chosen = data.select(2, 1)

    assert [d.N for d in chosen.experiments()] == [4, 3]
    np.testing.assert_array_equal(chosen.valid[4:], [True, False, True])
    assert chosen.history == (*data.history, "selected experiments 2, 1 of 3")
    for which in ((3,), (-1,), ()):
        with pytest.raises(ValueError, match="needs numbers from 0 to 2: there are 3 experiments"):
            data.select(*which)


@pytest.mark.parametrize("kind", ["time", "spectrum", "values"])
def test_data_show_themselves_with_their_gaps(kind: str) -> None:
    n = np.arange(200)
    part = Dataset(
        u=n % 3, y=np.cos(n), Ts=0.01, valid=n % 70 > 3, output="theta_1", unit="rad", source="ab"
    )
    figure, ax = plt.subplots()

    assert merge([part, part]).plot(kind, ax=ax) is ax.figure  # type: ignore[arg-type]

    figure.canvas.draw()
    texts = [text.get_text() for text in ax.texts]
    assert "rad" in "".join([ax.get_xlabel(), ax.get_ylabel(), *texts])
    plt.close(figure)
    with pytest.raises(ValueError, match="kind='bode' must be one of time, spectrum, values"):
        part.plot("bode")  # type: ignore[arg-type]
