"""The host that tests a device: the host changes the device's state and requests samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from armrig_protocol import messages as wire
from armrig_protocol.messages import SCHEMA_HASH, VERSION, Mode, State

from armrig_daemon.conformance.conversation import PATIENCE_MS, Broken, Conversation, only
from armrig_daemon.conformance.line import Line

BOOT_MS = 8_000
"""Longest time of a boot, including the boot loader, in ms."""
_HELLO_MS = 200
ALIVE_MS = 40
"""Interval between the KEEPALIVEs of a waiting host, in ms."""
CONFIG: dict[str, int] = {
    "ts_us": 10_000,
    "u_min": 0,
    "u_max": 65_535,
    "u_rest": 0,
    "slew": 0,
    "watchdog_ms": 250,
    "mode": Mode.EXCHANGE,
    "underrun": 0,
    "hold": 0,
    "oversampling": 1,
    "rail_ticks": 0,
    "turns": 0,
}


class Host(Conversation):
    """A host at one end of a line."""

    def __init__(self, line: Line, baud: int = 500_000) -> None:
        """Set the next seq to 0 and send nothing; `baud` is the speed of the line, in bit/s."""
        super().__init__(line)
        self.baud = baud
        self.k = 0
        """Index of the last EXCHANGE."""

    def put(self, kind: type[wire.Message], *, seq: int | None = None, **fields: Any) -> int:
        """Send a frame and return its seq.

        ARM and START contain the values of the last CONFIG_R, unless `fields` contains other
        values.
        """
        if kind is wire.Arm:
            known = {"boot_id": self.known.boot_id, "config_crc": self.config_crc}
            fields = {**known, "nonce": self.nonce, **fields}
        if kind is wire.Start:
            fields = {"k_stop": 0, "nonce": self.nonce, **fields}
        return super().put(kind, seq=seq, **fields)

    @property
    def known(self) -> wire.HelloReply:
        """Last HELLO_R of the device."""
        if self.facts is None:
            raise Broken("no HELLO_R yet")
        return self.facts

    @property
    def rx_us(self) -> int:
        """Time at which the last PING arrived, by the device's clock."""
        if self.pong is None:
            raise Broken("no PONG yet")
        return self.pong.rx_us

    def hello(self, within_ms: float = PATIENCE_MS) -> wire.HelloReply:
        """Return the answer to HELLO; repeat HELLO, because a booting device receives nothing."""
        end_ns = self.line.now_ns() + round(within_ms * 1e6)
        while True:
            self.put(wire.Hello, version=VERSION, schema=SCHEMA_HASH)
            try:
                self.until(lambda m: isinstance(m, wire.HelloReply), "HELLO_R", _HELLO_MS)
            except Broken:
                if self.line.now_ns() > end_ns:
                    raise
            else:
                return self.known

    def configure(self, **fields: int) -> wire.ConfigReply:
        """Return the answer to CONFIG."""
        self.put(wire.Config, **{**CONFIG, **fields})
        return only(wire.ConfigReply, self.fence())

    def exchange(self, u: int, *, k: int | None = None) -> wire.Message:
        """Return the answer to an EXCHANGE, normally SAMPLE; k is the next index by default."""
        self.k = self.k + 1 if k is None else k
        seq = self.put(wire.Exchange, k=self.k & 0xFFFF_FFFF, u=u)

        def answers(m: wire.Message) -> bool:
            mine = isinstance(m, wire.Ack) and m.of_seq == seq
            return (
                mine or isinstance(m, wire.Event) or (isinstance(m, wire.Sample) and m.k == self.k)
            )

        return self.until(answers, "answer to EXCHANGE")[-1]

    def sample(self, u: int = 0, *, k: int | None = None) -> wire.Sample:
        """Return the SAMPLE of an EXCHANGE."""
        came = self.exchange(u, k=k)
        if not isinstance(came, wire.Sample):
            raise Broken(f"{type(came).__name__} as answer to EXCHANGE")
        return came

    def to_idle(self) -> None:
        """Go to IDLE from any state."""
        self.put(wire.Stop)  # takes effect with any seq, and ends RUN
        self.hello()
        self.k = 0
        self.fence()
        if self.state in (State.FAULT, State.ESTOP):
            self.ask(wire.ClearFault, token=self.known.token)
        if self.state != State.IDLE:
            raise Broken(f"state {self.state} after STOP and CLEAR_FAULT, not IDLE")

    def reach(self, state: State, **config: int) -> None:
        """Go from IDLE to `state` by the shortest way; `config` overrides values of `CONFIG`."""
        if state is State.ESTOP:
            self.ask(wire.Estop)
        elif state is State.FAULT:
            self.reach(State.RUN, u_max=1_000)
            self.exchange(1_001)
        elif state is not State.IDLE:
            self.configure(**config)
            if state is not State.READY:
                self.ask(wire.Arm)
            if state is State.RUN:
                self.ask(wire.Start)
        self.fence()
        if self.state != state:
            raise Broken(f"state {self.state} on the way to {state.name}")

    def enter(self, state: State, **config: int) -> None:
        """Go to `state` from any state; `config` overrides values of `CONFIG`."""
        self.to_idle()
        self.reach(state, **config)

    def alive(
        self, ms: float, until: Callable[[wire.Message], bool] | None = None
    ) -> list[wire.Message]:
        """Send KEEPALIVEs for `ms`, or until a message matches; return the messages."""
        end_ns = self.line.now_ns() + round(ms * 1e6)
        came: list[wire.Message] = []
        while self.line.now_ns() < end_ns:
            self.put(wire.Keepalive)
            came += self.listen(ALIVE_MS)
            if until is not None and any(map(until, came)):
                break
        return came
