"""The reference of data from a closed loop, and the law in their history."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.data.dataset import Dataset, Signals
from armrig.data.merging import merge
from armrig.data.step import TWO_STAGE, Step, law_step, laws_of, loop_notes, with_notes
from armrig.data.treatment import detrend, difference, hampel, prefilter, resample
from armrig_core.errors import InputError

LAW = "4e361ae2a1fe" + 52 * "0"
N = 400
R = np.arange(N, dtype=np.float64)


def data(**changes: object) -> Dataset:
    rng = np.random.default_rng(1)
    fields = {"u": rng.standard_normal(N), "y": rng.standard_normal(N), "Ts": 0.1, "r": R}
    return Dataset(**(fields | {"history": [law_step(LAW)]} | changes))


@pytest.mark.parametrize("treat", [detrend, difference, hampel, lambda d: d.replaced(step="s")])
def test_a_treatment_of_samples_keeps_the_reference_and_the_law(treat: object) -> None:
    treated = treat(data())  # type: ignore[operator]

    np.testing.assert_array_equal(treated.r, R)
    assert laws_of(treated.history) == (LAW,)


@pytest.mark.parametrize(
    "treat", [lambda d: resample(d, 0.2), lambda d: prefilter(d, band=(1.0, 10.0))]
)
def test_a_filter_drops_the_reference_and_keeps_the_law(treat: object) -> None:
    treated = treat(data())  # type: ignore[operator]

    assert treated.r is None
    assert laws_of(treated.history) == (LAW,)


def test_parts_have_their_samples_of_the_reference() -> None:
    whole = data()
    first, second, third = whole[10:].split(3)
    joined = merge([third, first])

    np.testing.assert_array_equal(second.r, R[140:270])
    np.testing.assert_array_equal(joined.r, [*R[270:], *R[10:140]])
    np.testing.assert_array_equal(joined.select(1).r, R[10:140])
    np.testing.assert_array_equal(next(joined.experiments()).signals().r, R[270:])
    assert laws_of(joined.history) == (LAW,)


def test_a_merge_with_data_without_a_reference_has_none_but_names_the_law() -> None:
    """Its parts differ in their history, so the step is that of a part."""
    joined = merge([data(r=None, history=[]), data()])

    assert joined.r is None
    assert laws_of(joined.history) == (LAW,)
    assert "part 2: controlled by the law 4e361ae2a1fe" in joined.history


def test_the_digest_does_not_depend_on_the_reference() -> None:
    assert data().digest == data(r=None).digest


@pytest.mark.parametrize(
    ("r", "part"),
    [(R[:-1], "r has 399 samples and the data have 400"), (np.full(N, np.nan), "r[0] is nan")],
)
def test_a_reference_is_known_at_each_sample(r: np.ndarray, part: str) -> None:
    with pytest.raises(InputError) as err:
        data(r=r)

    assert part in str(err.value)


def test_the_reference_is_that_of_all_channels_and_cannot_be_changed() -> None:
    signals = Signals(u=R, y=np.column_stack([R, -R]), Ts=1.0, r=R)

    assert signals.dataset("y2").r is signals.r
    assert signals.channels("y1").r is not None
    with pytest.raises(ValueError, match="read-only"):
        signals.dataset("y1").r[0] = 1.0


def test_the_note_on_a_loop_is_the_first_line() -> None:
    (note,) = loop_notes([law_step(LAW), law_step("")], "armrig.bj(data)")

    assert note.startswith("controlled by the law 4e361ae2a1fe and a client's controller: coloured")
    assert with_notes(["a", "b"], ["c", note], "note") == f"note: {note}\na\nb\n  note: c"
    assert loop_notes(["controlled by me"]) == ()
    assert loop_notes([law_step(LAW), Step("of two stages", TWO_STAGE)]) == ()
