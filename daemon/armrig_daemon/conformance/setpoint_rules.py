"""Rules of section 6: SETPOINTS and the queue."""

from __future__ import annotations

from armrig_core.rig.volts import applied_code
from armrig_protocol.messages import (
    SETPOINTS_PER_FRAME,
    Cause,
    Code,
    Event,
    Setpoints,
    State,
)

from armrig_daemon.conformance.conversation import only
from armrig_daemon.conformance.host import Host
from armrig_daemon.conformance.rule import codes, expect, kinds, rule
from armrig_daemon.conformance.scheduled_rules import (
    NOISE,
    armed,
    fill,
    put_setpoints,
    queued,
    run_to_end,
)

_PLACES = SETPOINTS_PER_FRAME


@rule(6, "The queue has no gaps: setpoints after a gap are ignored, equal setpoints add nothing")
def _holes(host: Host) -> None:
    armed(host)
    for k0, u, wanted in (
        (0, [1, 2, 3], 3),
        (3, [4], 4),
        (1, [2, 3], 4),
        (2, [3, 4, 5, 6], 6),
        (7, [8], 6),
    ):
        put_setpoints(host, k0, u)
        came = host.fence()
        expect(not came, came)
        held = queued(host)
        expect(held == wanted, f"{held} queued after k0={k0}, n={len(u)}, not {wanted}")


@rule(6, "Setpoints that differ from the queue's are answered BAD_VALUE; the queue does not change")
def _disagree(host: Host) -> None:
    armed(host)
    fill(host, [1_000, 2_000, 3_000])
    for wrong in ([9, 2_000, 3_000], [1_000, 2_000, 9_000], [1_000, 9, 3_000, 4_000]):
        put_setpoints(host, 0, wrong)
        came = host.fence()
        expect(codes(came) == [Code.BAD_VALUE] and len(came) == 1, came)
    expect(queued(host) == 3, f"{queued(host)} queued, not 3")
    bits = host.known.pwm_bits
    got = [m.u_k for m in run_to_end(host, 4).samples]
    wanted = [applied_code(u, bits) for u in (1_000, 2_000, 3_000)]
    expect(got == [*wanted, 0], f"u_k {got}, not {[*wanted, 0]}")


@rule(6, "The queue has the capacity in HELLO_R; further setpoints are dropped without an answer")
def _capacity(host: Host) -> None:
    armed(host)
    queue = host.known.queue
    fill(host, NOISE[: queue + _PLACES])
    held = queued(host)
    expect(held == queue, f"{held} queued, {queue} in HELLO_R")


@rule(6, "The queue holds entries of at most `queue`/8 frames, even if the frames are short")
def _frames(host: Host) -> None:
    armed(host)
    most = host.known.queue // 8
    for k in range(most + 1):
        put_setpoints(host, k, [k])
    came = host.fence()
    expect(not came, came)
    held = queued(host)
    expect(held == most, f"{held} queued of {most + 1} frames with one setpoint each, not {most}")


@rule(6, "SETPOINTS with n = 0, n > 24, or `zero` other than 0 is answered BAD_VALUE")
def _bad(host: Host) -> None:
    armed(host)
    for fields in ({"n": 0}, {"n": _PLACES + 1}, {"n": 255}, {"zero": 1}):
        put_setpoints(host, 0, [1, 2], **fields)
        came = host.fence()
        expect(codes(came) == [Code.BAD_VALUE] and len(came) == 1, came)
        expect(queued(host) == 0, "entries in the queue")


@rule(
    6,
    "A frame with a code outside [u_min, u_max] leads to FAULT(RANGE); padding is ignored",
)
def _range(host: Host) -> None:
    armed(host, u_max=30_000)
    put_setpoints(host, 0, [1, 2])
    padded = (1, 2, 3, *(65_535,) * (_PLACES - 3))
    host.put(Setpoints, k0=0, n=3, zero=0, u=padded)
    came = host.fence()
    expect(not came and queued(host) == 3, came)
    _trips(host, 3, [4, 30_001], Cause.RANGE, 30_001)


@rule(6, "A step above `slew` between indices leads to FAULT(SLEW); before index 0, u is u_rest")
def _slew(host: Host) -> None:
    for frames, detail in (
        ([(0, [101])], 101),
        ([(0, [100, 201])], 201),
        ([(0, [100, 200]), (2, [301])], 301),
    ):
        host.to_idle()
        armed(host, slew=100)
        for k0, u in frames[:-1]:
            put_setpoints(host, k0, u)
        _trips(host, *frames[-1], Cause.SLEW, detail)


def _trips(host: Host, k0: int, u: list[int], cause: Cause, detail: int) -> None:
    put_setpoints(host, k0, u)
    came = host.fence()
    expect(kinds(came) == [Event], came)
    event = only(Event, came)
    reported = (event.was, event.state, event.cause, event.detail)
    expect(reported == (State.ARMED, State.FAULT, cause, detail), f"{reported}")


RULES = (
    _holes,
    _disagree,
    _capacity,
    _frames,
    _bad,
    _range,
    _slew,
)
