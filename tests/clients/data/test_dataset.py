"""A Dataset cannot exist in a bad state, and never hides a gap."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pandas as pd
import pytest
from armrig.data.argument import as_dataset
from armrig.data.dataset import Dataset, Signals
from armrig.data.experiments import Trend
from armrig.data.figures import plot_values, without_ramp
from armrig.data.merging import merge
from armrig.data.step import span_of
from hypothesis import assume, given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from tests.clients.made_recordings import of_the_arm, written


def ramp(N: int, **others: object) -> Dataset:
    """Return a Dataset whose numbers are their places."""
    n = np.arange(float(N))
    return Dataset(u=n, y=-n, Ts=0.1, **others)  # type: ignore[arg-type]


def ramps(N: int, **others: object) -> Signals:
    """Return the Dataset's numbers as columns of two inputs and two outputs."""
    u = np.column_stack([np.arange(float(N)), np.ones(N)])
    if "valid" in others:
        others["valid"] = np.column_stack([others["valid"], np.ones(N)])
    return Signals(u=u, y=-u, Ts=0.1, **others)  # type: ignore[arg-type]


SHAPES = pytest.mark.parametrize("make", [ramp, ramps], ids=["1×1", "2×2"])
Make = Callable[..., Any]


@pytest.mark.parametrize("make", [Dataset, Signals])
def test_the_arrays_are_read_only_copies(make: Make) -> None:
    u, y = np.zeros(3), np.arange(3.0)

    data = make(u=u, y=y, Ts=0.1)
    u[0] = y[0] = 9.0

    assert data.u[0] == data.y[0] == 0.0
    for array in (data.u, data.y, data.valid):
        assert array.flags.f_contiguous
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"u": [0.0, np.nan, 0.0]}, "u is not finite at 1 sample, first nan at 1"),
        ({"u": pd.Series([1.0, np.nan, 3.0])}, "u is not finite at 1 sample, first nan at 1"),
        (
            {"u": pd.Series(["a", "b", "c"])},
            "u is a column of .*; give numbers, see pandas.to_numeric",
        ),
        (
            {"u": pd.DataFrame({"u": [1.0, 2.0, 3.0]})},
            r"u is a table of pandas with shape \(3, 1\); give one column, df",
        ),
        ({"u": [[1.0, 2.0, 3.0]]}, r"u has shape \(1, 3\).*ravel"),
        ({"y": np.array([0, 1j, 2])}, r"y is complex \(complex128\), but must be real"),
        ({"u": [0.0, 1.0 + 0j, 2.0]}, "u is complex"),
        (
            {"u": np.ma.masked_equal([0.0, 1.0, 2.0], 1.0)},
            "u is not finite at 1 sample.*cut these",
        ),
    ],
)
def test_an_invalid_dataset_is_refused(arguments: dict[str, object], message: str) -> None:
    good = {"u": [0.0, 1.0, 2.0], "y": [0.0, 1.0, 2.0], "Ts": 0.1}

    with pytest.raises(ValueError, match=message):
        Dataset(**(good | arguments))  # type: ignore[arg-type]


@SHAPES
@given(st.integers(1, 40), st.integers(1, 40))
def test_the_parts_of_a_split_join_to_the_whole(make: Make, N: int, k: int) -> None:
    assume(make is ramp or N > 1)  # fewer samples than channels are refused
    data = make(N)
    if k > N:
        with pytest.raises(ValueError, match=f"into {k} parts: 1 to {N} are possible"):
            data.split(k)
        return

    parts = data.split(k)

    np.testing.assert_array_equal(np.concatenate([p.u for p in parts]), data.u)
    assert max(p.N for p in parts) - min(p.N for p in parts) <= 1


@SHAPES
def test_a_slice_keeps_the_boundaries_inside_it(make: Make) -> None:
    data = merge([make(4), make(4), make(4)])

    assert data[2:10].starts == (0, 2, 6)
    assert data[4:8].starts == (0,)
    assert data[0:12] is data
    assert len(data[2:10]) == 8
    with pytest.raises(TypeError, match="cut with data"):
        data[::-1]


@SHAPES
def test_experiments_are_selected_by_their_numbers(make: Make) -> None:
    data = merge([make(2), make(3, valid=[True, False, True]), make(4)])

    chosen = data.select(2, 1)

    assert [d.N for d in chosen.experiments()] == [4, 3]
    np.testing.assert_array_equal(chosen.signals().valid[4:, 0], [True, False, True])
    np.testing.assert_array_equal(chosen.u, np.concatenate([data.u[5:], data.u[2:5]]))
    assert chosen.history == (*data.history, "selected experiments 2, 1 of 3")
    with pytest.raises(ValueError, match="needs numbers from 0 to 2"):
        data.select(-1)


@SHAPES
def test_a_part_of_a_part_keeps_its_time_in_the_whole(make: Make) -> None:
    """From the first sample to the end of the last, in s."""
    whole = make(100)

    assert span_of(whole.history) == (0.0, np.inf)
    assert span_of(whole[10:90].history) == pytest.approx((1.0, 9.0))
    assert span_of(whole[10:90][20:50].history) == pytest.approx((3.0, 6.0))
    assert span_of(whole[10:90][70:].history) == pytest.approx((8.0, 9.0))
    assert span_of(merge([whole[:10], whole[20:]]).history) is None


@pytest.mark.parametrize(("slope", "shown"), [(0.7, "− 0.7"), (-2.5, "+ 2.5")])
@pytest.mark.parametrize("unit", ["rad", ""])
def test_an_output_near_a_ramp_is_drawn_without_its_slope(
    slope: float, shown: str, unit: str
) -> None:
    """The label names what is subtracted, and the note names the rate with its sign."""
    t = 0.05 * np.arange(300)
    y = slope * t + 0.1 * np.sin(5 * t)
    data = Dataset(u=np.arange(300) % 7, y=y, Ts=0.05, valid=np.arange(300) > 40, unit=unit)

    ramp, label, (note,) = without_ramp(data)

    fitted = np.polyfit(t[41:], y[41:], 1)[0]
    np.testing.assert_allclose(ramp, fitted * t)
    assert fitted == pytest.approx(slope, rel=0.02)
    digits = f"{abs(fitted):.3g}"
    assert label == f"y {shown[0]} {digits} $t$\n[{unit or '–'}]"
    sign = "−" if slope < 0 else ""
    assert note == f"y minus its mean rate, {sign}{digits}\xa0{unit}{'/s' if unit else 'per s'}"
    few = data.replaced(step=None, u=np.minimum(np.arange(300) // 80, 9.0))
    assert without_ramp(few)[2] == without_ramp(data.replaced(step=None, y=np.cos(t)))[2] == ()


def test_histograms_count_the_valid_samples_only() -> None:
    data = Dataset(u=np.arange(200) % 3, y=np.cos(np.arange(200)), Ts=1, valid=np.arange(200) > 49)

    ax = plot_values(data, ax=Figure().add_subplot())

    counts = [sum(bar.get_height() for bar in panel.patches) for panel in ax.figure.axes]  # type: ignore[attr-defined]
    assert counts == [150, 200]
    assert [panel.get_xlabel() for panel in ax.figure.axes] == ["y [–]", "$u$ [V]"]


@SHAPES
def test_merged_trends_are_those_of_each_experiment(make: Make) -> None:
    """An experiment without a trend among others has a trend of 0."""
    taken = Trend(u_level=1.0, y_slope=2.0)
    plain, detrended = make(3), make(4, trends=(taken,))
    (taken,), (none,) = detrended.trends, make(3, trends=(Trend(),)).trends

    assert merge([plain, plain]).trends == ()
    assert merge([merge([plain, plain]), detrended]).trends == (none, none, taken)
    assert merge([detrended, plain])[1:6].trends == (taken.later(0.1), none)
    assert merge([detrended, plain])[4:].trends == (none,)
    assert merge([detrended, plain])[:4].trends == (taken,)


def test_a_number_that_is_too_large_or_too_small_is_refused_by_its_name() -> None:
    with pytest.raises(
        ValueError, match=r"the largest \|u\| is 2e\+30; use a unit .* below 1e\+30"
    ):
        Dataset(u=[1.0, -2e30], y=[0.0, 1.0], Ts=1)
    with pytest.raises(ValueError, match=r"the largest \|y\| is 1e-40; .* from 1e-30 to 1e\+30"):
        as_dataset(Dataset(u=[1.0, 2.0], y=[0.0, -1e-40], Ts=1))
    hidden = Dataset(u=[1.0, 2.0], y=[1e99, 0.0], Ts=1, valid=[False, True])
    assert as_dataset(hidden) is hidden


@SHAPES
def test_many_merged_parts_are_listed_up_to_the_eighth(make: Make) -> None:
    parts = [make(n + 1, source=f"{n % 2}{n % 2}") for n in range(1, 10)]

    for count, listed in ((8, "2, 3, 4, 5, 6, 7, 8, 9"), (9, "2, 3, 4, 5, 6, 7, 8, 9, …")):
        merged = merge(parts[:count])
        assert merged.history == (f"merged {count} parts of {listed} samples",)
        assert merged.source == "11+00"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder: Path = tmp_path_factory.mktemp("argument")
    return armrig.load(written(folder, of_the_arm(armrig.telegraph(600, 0.05))))


def test_estimators_and_tests_accept_a_recording(recording: Any) -> None:
    data = recording.dataset()
    fit = armrig.arx(recording, na=4, nb=4)

    assert fit.theta.tolist() == armrig.arx(data=data, na=4, nb=4).theta.tolist()
    tested = armrig.residuals(fit, recording)
    assert tested.white.p_value == armrig.residuals(fit, data).white.p_value
    assert armrig.compare(recording, fit)[0].fit_percent == armrig.compare(data, fit)[0].fit_percent
    assert armrig.hampel(recording).N == data.N
    assert repr(armrig.advice(recording)) == repr(armrig.advice(data))


U = [1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize(
    "y",
    [
        [1.0, np.nan, 3.0, 4.0],
        np.ma.masked_array([1.0, 1e6, 3.0, 4.0], mask=[False, True, False, False]),
        pd.Series([1, None, 3, 4], dtype="Int64"),
        pd.Series([1.0, None, 3.0, 4.0], dtype=object),
        pd.Series([1.0, np.nan, 3.0, 4.0], index=[9, 8, 7, 6]),
    ],
    ids=["list", "masked", "Int64", "object", "another index"],
)
def test_a_missing_value_is_a_missing_output(y: Any) -> None:
    """A sample is missing by its value, or by `valid`."""
    both = pd.Series([True, True, False, None], dtype="boolean")
    data, fewer = (Dataset(u=pd.Series(U), y=y, Ts=1, valid=valid) for valid in (None, both))

    assert data.u.tolist() == U
    np.testing.assert_array_equal(data.y, [1, np.nan, 3, 4])
    assert data.valid.tolist() == [True, False, True, True]
    np.testing.assert_array_equal(fewer.y, [1, np.nan, np.nan, np.nan])
    assert fewer.valid.tolist() == [True, False, False, False]


def test_orders_by_position_are_refused_with_their_names(recording: Any) -> None:
    call: Any = armrig.arx
    with pytest.raises(TypeError, match=r"by name: arx\(data, na=4, nb=4, nk=1\)"):
        call(recording, [4, 4, 1])
    with pytest.raises(TypeError, match=r"arx\(data, na=4, nb=4, nk=1\)"):
        call(recording, 4, 4, 1)
