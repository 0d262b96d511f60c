"""Numbers of unknowns of a structure, and the names of structures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from armrig.models.structure import Structure, free_columns, offset_from_ramp
from armrig.models.structure_table import with_article
from armrig.numerics.polynomial import apply_filter


@pytest.mark.parametrize(
    ("orders", "memory", "count", "first", "trend"),
    [
        # ARX: the first errors need na past y, or nk + nb - 1 past u.
        ({"na": 2, "nb": (3,), "nk": (2,)}, 2, 0, 4, 0),
        ({"na": 2, "nb": (1,), "nk": (1,), "offset": True}, 2, 0, 1, 1),
        # ARARX: D acts on A y and on B u.
        ({"na": 2, "nb": (3,), "nk": (2,), "nd": 3}, 5, 0, 7, 0),
        ({"na": 2, "nb": (2,), "nk": (1,), "nc": 3}, 3, 0, 2, 0),
        ({"na": 3, "nb": (2,), "nk": (1,), "nc": 2, "integrator": "a"}, 3, 0, 2, 1),
        # OE: as many pulses as B/F has states.
        ({"nb": (2,), "nf": (3,), "nk": (1,)}, 0, 3, 0, 0),
        ({"nb": (2,), "nf": (3,), "nk": (4,), "offset": True}, 0, 5, 0, 1),
        ({"nb": (3,), "nf": (0,), "nk": (0,)}, 0, 2, 0, 0),
        ({"nb": (2,), "nf": (3,), "nk": (1,), "integrator": "f"}, 0, 3, 0, 2),
        ({"nb": (5,), "nf": (1,), "nk": (1,), "integrator": "f"}, 0, 4, 0, 2),
        # BJ, and B alone with coloured noise.
        ({"nb": (2,), "nf": (2,), "nk": (1,), "nc": 1, "nd": 2}, 2, 2, 0, 0),
        ({"nb": (2,), "nf": (0,), "nk": (2,), "nd": 2}, 2, 0, 5, 0),
        ({"nb": (2,), "nf": (2,), "nk": (1,), "nd": 2, "at_rest": True}, 2, 0, 0, 0),
        ({"nb": (2,), "nf": (2,), "nk": (1,), "integrator": "f", "at_rest": True}, 0, 0, 0, 0),
    ],
)
def test_each_structure_has_its_number_of_parameters(
    orders: dict[str, Any], memory: int, count: int, first: int, trend: int
) -> None:
    s = Structure(**{"nf": (0,)} | orders)

    assert (s.memory, s.counts, s.first, s.trend) == (memory, (count,), first, trend)
    assert s.white == (memory == 0)
    assert s.lags(0)[-1] == orders["nk"][0] + orders["nb"][0] - 1


@pytest.mark.parametrize(
    ("orders", "groups", "counts", "first"),
    [
        ({"nf": (2, 1)}, ((0,), (1,)), (2, 4), 0),
        # The inputs without an F have one state, and with a noise model no pulses.
        ({"nf": (0, 0)}, ((0, 1),), (4,), 0),
        ({"nf": (0, 0), "nd": 1}, ((0, 1),), (0,), 5),
        ({"nf": (0, 2), "nd": 1}, ((0,), (1,)), (0, 4), 3),
        ({"nf": (2, 2), "shared": True}, ((0, 1),), (4,), 0),
        ({"nf": (2, 0), "nb": (2, 0)}, ((0,),), (2,), 0),
    ],
)
def test_the_inputs_with_one_denominator_have_one_state(
    orders: dict[str, Any], groups: Any, counts: Any, first: int
) -> None:
    """The second input acts four samples later."""
    s = Structure(**{"nb": (2, 2), "nk": (1, 3)} | orders)

    assert (s.groups, s.counts, s.first) == (groups, counts, first)


def test_the_offset_is_recovered_from_its_ramp() -> None:
    """B/F̃ of the summed input: the slope is the gain times mean(u) - u0 = 0.6."""
    B, F = np.array([0.0, 0.2, 0.3]), np.array([1.0, -0.6, 0.1])
    u = np.full(400, 0.6)
    y = apply_filter(B, F, np.cumsum(u))
    slope = float(y[-1] - y[-2])

    assert offset_from_ramp(B, F, slope, 1.5) == pytest.approx(1.5 - 0.6)
    assert offset_from_ramp(B, F, -slope, 1.5) == pytest.approx(1.5 + 0.6)
    assert np.isnan(offset_from_ramp(np.array([0.0, 1.0, -1.0]), F, slope, 1.5))


def test_free_columns_are_delayed_responses_then_level_and_ramp() -> None:
    F = np.array([1.0, -0.5])

    columns = free_columns(F, 4, count=2, drift=True)

    expected = [[1, 0, 1, 1], [0.5, 1, 1, 2], [0.25, 0.5, 1, 3], [0.125, 0.25, 1, 4]]
    np.testing.assert_allclose(columns, expected)
    np.testing.assert_array_equal(free_columns(F, 4, count=2, drift=False), columns[:, :2])


def test_the_indefinite_article_follows_the_spoken_letter() -> None:
    """An F, an L, an M, an N, an R, an S and an X begin with a vowel when they are spelled."""
    spelled = {letter: with_article(letter).split()[0] for letter in "ABCDEFHJLMNPRSTUVX"}

    assert {letter for letter, article in spelled.items() if article == "an"} == set("AEFHLMNRSX")
