"""Messages for Foxglove and similar programs, and the next connection to a silent rig."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from armrig.dashboard import foxglove
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.telemetry import decode_sample
from armrig_core.telemetry.topics import STREAMS

from tests.clients.made_recordings import event, sample


class _Ends:
    """Waits without a pause, and so often."""

    def __init__(self, most: int) -> None:
        self.waited, self._most = 0, most

    def wait(self, _: float) -> bool:
        self.waited += 1
        return self.waited > self._most


def _passed_on(
    monkeypatch: pytest.MonkeyPatch, published: dict[str, list[list[Any]]], most: int = 1000
) -> tuple[dict[str, list[Any]], int]:
    """Return what each channel was given, and the number of periods until the end."""
    given: dict[str, list[Any]] = {name: [] for name in (*STREAMS, "transforms")}

    class Channel:
        def __init__(self, name: str) -> None:
            self.log = given[name].append

    class Rig:
        @contextmanager
        def arrivals(self, name: str) -> Iterator[Callable[[], list[Any]]]:
            lots = iter(published.get(name, []))
            yield lambda: next(lots, [])

    monkeypatch.setattr(foxglove, "transforms", lambda *angles: angles[:2])
    ends, rig = _Ends(most), Rig()
    channels = {name: Channel(name) for name in given}
    foxglove._pass_on(channels, rig, ends)  # type: ignore[arg-type]
    return given, ends.waited


def test_each_period_sends_the_newest_sample_and_every_other_message(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    samples = [sample(k, value_0=0.1 * k, value_1=-0.01 * k) for k in range(6)]
    events = [event(k, f"event {k}", "warning") for k in range(3)]

    given, _ = _passed_on(
        monkeypatch, {"sample": [samples[:3], [], samples[3:]], "event": [events]}
    )

    assert [decode_sample(data) for data in given["sample"]] == [samples[2], samples[5]]
    assert given["transforms"] == [(s.value_0, s.value_1) for s in (samples[2], samples[5])]
    heard = [protobuf.decode_message(protobuf.LOG, data).message for data in given["event"]]
    assert heard == ["event 0", "event 1", "event 2"]


@pytest.mark.parametrize("n", [0, 1, 40])
def test_a_rig_without_samples_for_three_seconds_is_connected_again(
    monkeypatch: pytest.MonkeyPatch, n: int
) -> None:
    """Other messages do not count: the end of a run may report on a rig that has stopped."""
    lots: dict[str, list[list[Any]]] = defaultdict(list)
    lots["sample"] = [[sample(k)] for k in range(n)]
    lots["event"] = [[event(k, "x")] for k in range(500)]

    given, periods = _passed_on(monkeypatch, lots)

    assert len(given["sample"]) == n
    assert (periods - n) * foxglove._PERIOD_S == pytest.approx(3.0, abs=0.05)


def test_the_end_of_the_server_ends_its_stream_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _passed_on(monkeypatch, {}, most=3) == ({n: [] for n in (*STREAMS, "transforms")}, 4)
