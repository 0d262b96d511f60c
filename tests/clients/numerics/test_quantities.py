"""Numbers as a reader wants them."""

from __future__ import annotations

from armrig.numerics.quantities import plural


def test_one_is_singular_and_all_other_numbers_plural() -> None:
    """None is many, too."""
    assert [plural(n, "sample") for n in (0, 1, 2)] == ["0 samples", "1 sample", "2 samples"]
