"""One direction of the line, with its effect on the frames."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from random import Random

from armrig_protocol.messages import TYPES, Arm, Config, Hello, Start

from tests.simulator.options import MS, Episode

HELLO, CONFIG, ARM, START = (TYPES[kind] for kind in (Hello, Config, Arm, Start))
_CONTROLS = (HELLO, CONFIG, ARM, START)

_MOST_KEPT = 400
Piece = tuple[int, bytes]
"""Time at which the bytes come out, and the bytes."""


class Line:
    """A way that loses, doubles, delays and spoils while an episode lasts."""

    def __init__(self, way: str, episodes: Sequence[Episode], rng: Random, faults: Counter[str]):
        """Take the episodes of this way out of `episodes`; count each blow in `faults`."""
        mine = [e for e in episodes if e.kind.endswith(way)]
        self._way, self._rng, self._faults = way, rng, faults
        self._edges = sorted({t for e in mine for t in (e.t_ns, e.end_ns)})
        self._episodes = mine
        self._now_on: dict[str, Episode] = {}
        self._last_ns = 0
        self._kept: deque[bytes] = deque(maxlen=_MOST_KEPT)
        self.controls: dict[int, bytes] = {}
        """The newest frame of each type."""
        self.cut_until_ns = 0
        """Nothing gets through before this."""

    def carry(self, t_ns: int, data: bytes) -> Sequence[Piece]:
        """Return the output of the line for the frame that goes in at `t_ns`."""
        self._kept.append(data)
        kind = data[1] if len(data) > 1 and data[0] else HELLO
        if kind in _CONTROLS:
            self.controls[kind] = data
        if self._edges and t_ns >= self._edges[0]:
            self._retune(t_ns)
        if t_ns < self.cut_until_ns:
            return ()
        if not self._now_on and t_ns >= self._last_ns:
            return ((t_ns, data),)
        return self._spoil(t_ns, data)

    def played_again(self) -> list[bytes]:
        """Return frames that lead a device without nonces to RUN, and the last sent frames."""
        ways = [HELLO, CONFIG, ARM, START]
        return [self.controls[w] for w in ways if w in self.controls] + list(self._kept)[-80:]

    def _retune(self, t_ns: int) -> None:
        self._edges = [t for t in self._edges if t > t_ns]
        self._now_on = {e.kind.split()[0]: e for e in self._episodes if e.t_ns <= t_ns < e.end_ns}

    def _strikes(self, kind: str) -> Episode | None:
        """Return the episode of this kind if it strikes this frame, and count it."""
        episode = self._now_on.get(kind)
        if episode is None or self._rng.random() > episode.size:
            return None
        self._faults[f"{kind} {self._way}"] += 1
        return episode

    def _spoil(self, t_ns: int, data: bytes) -> list[Piece]:
        rng = self._rng
        pieces: list[Piece] = []
        if self._strikes("garbage"):
            pieces.append((t_ns + MS // 10, rng.randbytes(rng.randint(1, 90))))
        if self._strikes("loss"):
            return pieces
        if self._strikes("flip"):
            spoilt = bytearray(data)
            for _ in range(rng.choice([1, 1, 2, 5])):
                spoilt[rng.randrange(len(spoilt))] ^= 1 << rng.randrange(8)
            data = bytes(spoilt)
        out_ns = max(t_ns, self._last_ns)
        delay = self._now_on.get("delay")
        if delay is not None:
            self._faults[f"delay {self._way}"] += 1
            # One half stalls and lets go in a burst, the other is late all the time.
            stalled = delay.end_ns if delay.size < 0.5 else 0
            out_ns = max(out_ns, stalled, t_ns + round(240 * MS * (delay.size - 0.5)))
        self._last_ns = out_ns
        if self._strikes("reorder"):
            out_ns += round(40 * MS * rng.random())
        if self._strikes("split") and len(data) > 1:
            cut = rng.randrange(1, len(data))
            pieces += [(out_ns, data[:cut]), (out_ns + rng.randrange(MS), data[cut:])]
            self._last_ns = max(self._last_ns, pieces[-1][0])
        else:
            pieces.append((out_ns, data))
        if self._strikes("duplicate"):
            pieces.append((out_ns + round(30 * MS * rng.random()), data))
        if self._kept and self._strikes("replay"):
            pieces.append((out_ns + rng.randrange(5 * MS), rng.choice(self._kept)))
        return pieces
