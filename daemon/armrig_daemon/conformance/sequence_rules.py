"""Rules of section 2: seq, echo, boot."""

from __future__ import annotations

from armrig_protocol import messages as wire
from armrig_protocol.messages import SCHEMA_HASH, TYPES, VERSION, Code, State

from armrig_daemon.conformance.byte_rules import UNKNOWN_TYPE, frame_bytes, header, next_status
from armrig_daemon.conformance.host import BOOT_MS, LineHost, only
from armrig_daemon.conformance.rule import NotTried, codes, expect, kinds, rule

_HELLO = {"version": VERSION, "schema": SCHEMA_HASH}
_U16 = 0xFFFF


@rule(2, "A frame whose seq is not 1 ... 32767 ahead of the newest is answered ACK(STALE)")
def _stale(host: LineHost) -> None:
    for lag in (0, 1, 32_767, 32_768):
        answers = _answers_to_old(host, lag)
        expect(codes(answers) == [Code.STALE], answers)


def _answers_to_old(host: LineHost, lag: int) -> list[wire.Message]:
    """Return the answers to a KEEPALIVE whose seq is the newest seq minus `lag`."""
    newest = host.seq
    host.put(wire.Keepalive, seq=(newest - lag) & _U16)
    host.seq = newest
    return host.fence()


@rule(2, "A seq 32767 ahead is newer, and seq wraps at 2^16")
def _ahead(host: LineHost) -> None:
    for _ in range(3):
        answers = host.ask(wire.Keepalive, seq=(host.seq + 32_767) & _U16)
        expect(not answers, answers)


@rule(2, "A frame of unknown type is answered by ACK(UNKNOWN_TYPE), and is not taken in")
def _unknown(host: LineHost) -> None:
    for number in (UNKNOWN_TYPE, TYPES[wire.Ack]):
        seq = (host.seq + 1) & _U16
        body = bytes(4) if number == TYPES[wire.Ack] else b""
        host.write(frame_bytes(header(number, seq) + body))
        answers = host.ask(wire.Keepalive)  # with the same seq, which is still unused
        expect(codes(answers) == [Code.UNKNOWN_TYPE], answers)
        ack = only(wire.Ack, answers)
        expect((ack.of_type, ack.of_seq) == (number, seq), f"ACK of {ack.of_type}, {ack.of_seq}")


@rule(2, "Outside ARMED and RUN, HELLO is always accepted, and its seq is then the newest")
def _hello(host: LineHost) -> None:
    for state in (State.IDLE, State.READY, State.ESTOP):
        host.enter(state)
        answers = host.ask(wire.Hello, seq=(host.seq - 1_000) & _U16, **_HELLO)
        expect(kinds(answers) == [wire.HelloReply], answers)


@rule(2, "In ARMED and RUN, an old HELLO is answered ACK(STALE)")
def _hello_armed(host: LineHost) -> None:
    for state in (State.ARMED, State.RUN):
        host.enter(state)
        newest = host.seq
        host.put(wire.Hello, seq=(newest - 5) & _U16, **_HELLO)
        host.seq = newest
        answers = host.fence()
        expect(codes(answers) == [Code.STALE] and len(answers) == 1, answers)


@rule(2, "STOP takes effect with any seq, and moves the newest seq only forward")
def _stop_always(host: LineHost) -> None:
    for kind, state in ((wire.Stop, State.IDLE), (wire.Estop, State.ESTOP)):
        host.enter(State.RUN)
        newest = host.seq
        host.put(kind, seq=(newest - 5) & _U16)
        host.put(wire.Keepalive, seq=(newest - 3) & _U16)  # newer than the STOP, but still stale
        host.seq = newest
        answers = host.fence()
        expect(codes(answers) == [Code.OK, Code.STALE] and host.state == state, answers)


@rule(2, "`echo` in SAMPLE is the seq of the newest accepted frame")
def _echo(host: LineHost) -> None:
    for ahead in (1, 300, 32_767):
        host.seq = (host.seq + ahead - 1) & _U16
        sample = host.sample()
        expect(sample.echo == host.seq, f"echo {sample.echo} of frame {host.seq}")


@rule(2, "The low half of boot_id is in every SAMPLE, EVENT and STATUS", silent=True)
def _boot(host: LineHost) -> None:
    low = host.known.boot_id & _U16
    sample = host.sample()
    expect(sample.boot == low, f"SAMPLE of boot {sample.boot:04x}, not {low:04x}")
    event = only(wire.Event, host.ask(wire.Estop))
    expect(event.boot == low, f"EVENT of boot {event.boot:04x}, not {low:04x}")
    status = next_status(host)
    expect(status.boot == low, f"STATUS of boot {status.boot:04x}, not {low:04x}")


@rule(
    2,
    "If opening the port resets the device, the state is IDLE, and boot_id has a new low half",
    silent=True,
)
def _reset(host: LineHost) -> None:
    before = host.known.boot_id
    host.reach(State.READY)
    host.reopen()
    after = host.hello(BOOT_MS)
    messages = host.fence()
    if after.boot_id == before:
        expect(host.state == State.READY, f"state {host.state} in the same boot, not READY")
        raise NotTried("opening the port does not reset this device")
    expect(after.state == State.IDLE, f"state {after.state} after a boot")
    halves = before & _U16, after.boot_id & _U16
    expect(halves[0] != halves[1], f"boot_id {before:08x} and then {after.boot_id:08x}")
    expect(host.configure(ts_us=0).config_crc == 0, "a configuration from before the boot")
    expect(not any(isinstance(m, wire.Sample) for m in messages), messages)
