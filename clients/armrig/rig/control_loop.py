"""Controller of one's own: a loop over the newest samples, in which the caller sets the voltage."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import LastRun
from armrig_core.errors import InputError
from armrig_core.telemetry.telemetry import Sample
from armrig_protocol.messages import Flag

from armrig.rig.replies import BusyError, RefusedError, complete_recording
from armrig.rig.session import RigError

if TYPE_CHECKING:
    from armrig.rig.client import Rig

SHORTEST_TS = 0.02
"""Shortest sampling time of a controller of one's own, in s: 50 Hz."""
_AFTER_THE_END = (RefusalCode.NOT_HELD,)  # refusals of a voltage whose run has ended
_LOOK_INTERVAL_S, _SILENCE_S = 0.001, 1.0  # without a sample for `_SILENCE_S`, the run is over


class LoopSample(NamedTuple):
    """Newest sample of a run: its number k, from 0, and the reference r.

    `sample` has the names of the rig, such as `y.sample.T1`. `set` sets the voltage of the
    next sample, as `Rig.set`; of several voltages before the next sample, the last one acts.
    """

    k: int
    r: float
    sample: Sample
    set: Callable[..., None]


class ControlLoop:
    """Run whose voltages the caller sets: iterate over its samples (see `Rig.control_loop`)."""

    def __init__(
        self, rig: Rig, reference: list[float], begin: Callable[[], Callable[[], LastRun]]
    ) -> None:
        """Prepare a run; `begin` begins it, and returns a function that waits for its recording."""
        self._rig, self._reference, self._begin = rig, reference, begin
        self._first: int | None = None
        self.deadlines = self.missed = 0
        """Number of deadlines, one for each sample but the first, and number of missed ones."""
        self.recording: Path | None = None
        """Path of the recording, when the run has ended."""

    def __iter__(self) -> Iterator[LoopSample]:
        """Begin the run and yield its samples; at each way out the input is at rest."""
        with self._rig.arrivals("sample") as samples, self._rig.arrivals("control") as decisions:
            end = self._begin()
            try:
                yield from self._samples(samples, decisions)
            except BaseException:  # also GeneratorExit: the caller has left the loop
                with suppress(RigError):
                    self._rig.stop()
                    self.recording = Path(end().recording)
                raise
            finally:
                self._count(decisions())
            last = end()
            self.recording = Path(last.recording)
            if self.missed:
                text = f"{self.missed} of {self.deadlines} deadlines were missed, and the voltage "
                text += "before was held: choose a longer Ts, or use a control law (Rig.control)"
                print(text, file=sys.stderr)
            complete_recording(last, len(self._reference))

    def _samples(
        self, samples: Callable[[], list[Any]], decisions: Callable[[], list[Any]]
    ) -> Iterator[LoopSample]:
        heard_s = time.monotonic()
        while time.monotonic() - heard_s < _SILENCE_S:
            arrived = samples()  # first: the daemon publishes the decision before its sample
            self._count(decisions())
            if self._first is None or not arrived or arrived[-1].k < self._first:
                time.sleep(_LOOK_INTERVAL_S)
                continue
            k = arrived[-1].k - self._first
            if k >= len(self._reference) - 1 or not arrived[-1].flags & Flag.RUN:
                return
            yield LoopSample(k, self._reference[k], arrived[-1], self._set)
            heard_s = time.monotonic()

    def _count(self, decided: list[Any]) -> None:
        if decided:
            self._first = decided[0].k if self._first is None else self._first
            self.deadlines, self.missed = decided[-1].k - self._first, decided[-1].predicted

    def _set(self, u: float | None = None, **values: float) -> None:
        try:
            self._rig.set(u, **values)
        except BusyError:
            pass  # the run ends, or too many commands came: the daemon counts the missed deadline
        except (InputError, RefusedError) as err:
            if getattr(err, "code", "") in _AFTER_THE_END:
                return  # as the next sample shows
            with suppress(RigError):
                self._rig.stop()
            raise
