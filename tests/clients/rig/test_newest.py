"""The newest messages within a bound; the oldest goes first."""

from __future__ import annotations

from armrig.rig.live_gaps import Newest
from hypothesis import example, given, settings
from hypothesis import strategies as st


@settings(max_examples=30)
@example([12, 8, 1, 1, 1, 1, (4,), 12, 8, None, 12, 8])
@given(st.lists(st.none() | st.integers(0, 12) | st.tuples(st.integers(0, 40)), max_size=40))
def test_what_is_kept_is_the_newest_that_fits(steps: list[int | tuple[int] | None]) -> None:
    """At most 4 items and 20 B."""
    queue, model = Newest[tuple[int, int]](4, 20), list[tuple[int, int]]()
    for number, step in enumerate(steps):
        if step is None:
            assert queue.take() == model
            model.clear()
        elif isinstance(step, tuple):
            last = step[0]
            queue.forget_while(lambda one, last=last: one[0] < last)  # type: ignore[misc]
            model = [one for one in model if one[0] >= last]
        else:
            queue.add((number, step), step)
            model.append((number, step))
            while len(model) > 4 or sum(size for _, size in model) > 20:
                del model[0]

        assert (list(queue), len(queue)) == (model, len(model))
