"""A virtual rig with the words of the tests."""

from __future__ import annotations

from collections.abc import Sequence
from struct import pack

from armrig_core.rig.description import Description
from armrig_core.rig.volts import code_of
from armrig_core.telemetry.telemetry import Sample, decode_sample
from armrig_daemon.config import Config
from armrig_daemon.decisions.state import Phase
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.pipe import Answer, Arm, Run, Set
from armrig_daemon.virtual import VirtualRig

LEASE = "a" * 32
MS = 1_000_000


class Bench(VirtualRig):
    """A virtual rig with the words of these tests."""

    def __init__(
        self,
        config: Config | None = None,
        *,
        switched_on_ns: int = 0,
        k: int = 0,
        description: Description | None = None,
        **emulator: float,
    ) -> None:
        self.lateness_ns = 0
        rules = (config or Config()).rules(description)
        settings = EmulatorSettings(**{"boot_ms": 0.0, "baud": rules.baud, **emulator})
        super().__init__(rules, settings, lambda: self.lateness_ns, switched_on_ns)
        self.loop._k = k
        self.loop._pace = self.loop._pace._replace(k_origin=k)
        self._number = 0
        self.run_for(300)

    def run_for(self, ms: float) -> None:
        self.run_until(self.ports.now + round(ms * MS))

    def ask(self, kind: type, **fields: object) -> Answer:
        self._number += 1
        self.order(kind(order=self._number, **fields))
        self.run_for(100)
        return next(a for a in self.of(Answer) if a.order == self._number)

    def of(self, kind: type) -> list:
        return [r for r in self.records if isinstance(r, kind)]

    @property
    def samples(self) -> list[Sample]:
        decoded = [decode_sample(r) for r in self.records if isinstance(r, bytes)]
        return [s for s in decoded if s is not None]

    @property
    def phase(self) -> Phase:
        return self.loop.state.phase

    @property
    def volts(self) -> float:
        return self.ports.device.board.volts

    def arm(self, ts_us: int = 0) -> Answer:
        return self.ask(Arm, owner="a student", lease=LEASE, ts_us=ts_us)

    def play(self, volts: Sequence[float], ts_us: int = 0, *, scheduled: bool = True) -> None:
        """Arm, and begin a run."""
        assert not self.arm(ts_us).error
        run = codes(*volts)
        self.order(Run(order=500, lease=LEASE, n=0, run_id="r", codes=run, scheduled=scheduled))

    def drive(self, volts: float, n: int) -> Answer:
        return self.ask(Set, lease=LEASE, n=n, code=code_of(volts))


def codes(*volts: float) -> bytes:
    """Return an experiment's codes."""
    return pack(f"<{len(volts)}H", *map(code_of, volts))
