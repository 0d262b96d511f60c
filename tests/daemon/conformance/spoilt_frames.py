"""Devices that break a rule of frames, their numbers and their order (sections 1 and 2)."""

from __future__ import annotations

from typing import Any
from zlib import crc32

from armrig_daemon.emulator import device, requests, transitions, uart
from armrig_daemon.emulator.firmware import Firmware
from armrig_protocol import cobs
from armrig_protocol.frame import Spoilt
from armrig_protocol.messages import Cause, Hello, HelloReply, Message, Pong, Sample, State, Stop

from tests.daemon.conformance.spoiling import Patch, SpoiltDevices

SPOILT = SpoiltDevices()


@SPOILT.function("two of the CRC's bytes are looked at", "wrong CRC", uart.decoder, "decode")
def _half_a_crc(decode: Any, stuffed: bytes) -> Any:
    text = cobs.unstuff(stuffed)
    if text and text[-4:-2] == crc32(text[:-4]).to_bytes(4, "little")[:2]:
        return decode(cobs.stuff(text[:-4] + crc32(text[:-4]).to_bytes(4, "little")))
    return decode(stuffed)


@SPOILT.function("lost bytes are not reported", "lost in a flood", uart.Reception, "put")
def _loses_bytes(put: Any, line: uart.Reception, now_ns: int, data: bytes) -> None:
    put(line, now_ns, data[:1000])


SPOILT.add(
    "old frames are taken", "ACK(STALE)", Patch.setattr, requests, "is_newer", lambda *_: True
)


@SPOILT.function(
    "the EVENT comes before its answer", "the answer first", transitions, "_transition"
)
def _event_before_answer(transition: Any, *args: Any) -> list[Message]:
    return transition(*args)[::-1]


SPOILT.answer("the echo is one behind", "`echo`", Sample, lambda m: {"echo": (m.echo - 1) & 0xFFFF})


@SPOILT.function("only the high half of boot_id is drawn", "a new low half", device.Device, "reset")
def _half_a_boot_id(reset: Any, of: device.Device, now_ns: int) -> None:
    low = of._fw.boot_id & 0xFFFF
    reset(of, now_ns)
    of._fw.boot_id = of._fw.boot_id & 0xFFFF_0000 | low


@SPOILT.function("the device skips a seq", "seq increases by 1", uart.Transmission, "send")
def _skips_a_seq(send: Any, line: Any, fw: Firmware, t_ns: int, messages: list[Message]) -> None:
    send(line, fw, t_ns, messages)
    line._seq = (line._seq + any(isinstance(m, HelloReply) for m in messages)) & 0xFFFF


@SPOILT.function("an old STOP makes old frames new", "with any seq", device, "handle")
def _stop_moves_back(handle: Any, fw: Firmware, now_ns: int, received: Any) -> list[Message]:
    made = handle(fw, now_ns, received)
    if isinstance(received, Stop):
        fw.newest = received.seq
    return made


SPOILT.answer(
    "PONG has a wrong time", "in order", Pong, lambda m: {"rx_us": (m.rx_us + 30_000) & 0xFFFFFFFF}
)


@SPOILT.handler("HELLO does not begin k anew", "after a HELLO, any k is new", Hello)
def _k_not_reset(hello: Any, fw: Firmware, now_ns: int, m: Hello) -> list[Message]:
    k = fw.k
    made = hello(fw, now_ns, m)
    fw.k = k
    return made


@SPOILT.function("noise stops it", "Random bytes", device, "handle")
def _spoilt_stops(handle: Any, fw: Firmware, now_ns: int, received: Any) -> list[Message]:
    made = handle(fw, now_ns, received)
    if isinstance(received, Spoilt) and fw.state is State.READY:
        fw.enter(now_ns, State.IDLE, Cause.NONE)
    return made
