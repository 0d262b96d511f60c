"""Devices that break a rule of frames, their numbers and their order (sections 1 and 2)."""

from __future__ import annotations

from typing import Any
from zlib import crc32

from armrig_daemon.emulator import device, requests, transitions, uart
from armrig_daemon.emulator.firmware import Firmware
from armrig_protocol import cobs, decoder
from armrig_protocol.frame import Spoilt
from armrig_protocol.messages import Cause, Hello, HelloReply, Message, Pong, Sample, State, Stop

from tests.daemon.conformance.spoiling import Patch, SpoiltDevice, changed_answers, other_handler


def _half_a_crc(patch: Patch) -> None:
    decode = decoder.decode

    def lenient(stuffed: bytes) -> Any:
        text = cobs.unstuff(stuffed)
        if text and text[-4:-2] == crc32(text[:-4]).to_bytes(4, "little")[:2]:
            return decode(cobs.stuff(text[:-4] + crc32(text[:-4]).to_bytes(4, "little")))
        return decode(stuffed)

    patch.setattr(uart.decoder, "decode", lenient)


def _loses_bytes(patch: Patch) -> None:
    put = uart.Reception.put

    def losing(self: uart.Reception, now_ns: int, data: bytes) -> None:
        put(self, now_ns, data[:1000])

    patch.setattr(uart.Reception, "put", losing)


def _stale_is_taken(patch: Patch) -> None:
    patch.setattr(requests, "is_newer", lambda number, last, mask: True)


def _stale_echo(patch: Patch) -> None:
    changed_answers(
        patch, lambda m: m._replace(echo=(m.echo - 1) & 0xFFFF) if isinstance(m, Sample) else m
    )


def _skips_a_seq(patch: Patch) -> None:
    send = uart.Transmission.send

    def skipping(self: uart.Transmission, fw: Firmware, t_ns: int, messages: list[Message]) -> None:
        send(self, fw, t_ns, messages)
        self._seq = (self._seq + any(isinstance(m, HelloReply) for m in messages)) & 0xFFFF

    patch.setattr(uart.Transmission, "send", skipping)


def _stop_moves_back(patch: Patch) -> None:
    handle = requests.handle

    def moving(fw: Firmware, now_ns: int, received: Any) -> list[Message]:
        made = handle(fw, now_ns, received)
        if isinstance(received, Stop):
            fw.newest = received.seq
        return made

    patch.setattr(device, "handle", moving)


def _k_not_reset(patch: Patch) -> None:
    def kept(old: Any) -> Any:
        def handler(fw: Firmware, now_ns: int, m: Hello) -> list[Message]:
            k = fw.k
            made = old(fw, now_ns, m)
            fw.k = k
            return made

        return handler

    other_handler(patch, Hello, kept)


def _spoilt_stops(patch: Patch) -> None:
    handle = requests.handle

    def stopping(fw: Firmware, now_ns: int, received: Any) -> list[Message]:
        made = handle(fw, now_ns, received)
        if isinstance(received, Spoilt) and fw.state is State.READY:
            fw.enter(now_ns, State.IDLE, Cause.NONE)
        return made

    patch.setattr(device, "handle", stopping)


def _pong_time(patch: Patch) -> None:
    changed_answers(
        patch,
        lambda m: m._replace(rx_us=(m.rx_us + 30_000) & 0xFFFFFFFF) if isinstance(m, Pong) else m,
    )


def _half_a_boot_id(patch: Patch) -> None:
    reset = device.Device.reset

    def same(self: device.Device, now_ns: int) -> None:
        low = self._fw.boot_id & 0xFFFF
        reset(self, now_ns)
        self._fw.boot_id = self._fw.boot_id & 0xFFFF_0000 | low

    patch.setattr(device.Device, "reset", same)


def _event_before_answer(patch: Patch) -> None:
    transition = transitions._transition
    patch.setattr(
        transitions, "_transition", lambda fw, t, m, state: transition(fw, t, m, state)[::-1]
    )


SPOILT: dict[str, SpoiltDevice] = {
    "two of the CRC's bytes are looked at": SpoiltDevice(_half_a_crc, "wrong CRC"),
    "lost bytes are not reported": SpoiltDevice(_loses_bytes, "lost in a flood"),
    "old frames are taken": SpoiltDevice(_stale_is_taken, "ACK(STALE)"),
    "the EVENT comes before its answer": SpoiltDevice(_event_before_answer, "the answer first"),
    "the echo is one behind": SpoiltDevice(_stale_echo, "`echo`"),
    "only the high half of boot_id is drawn": SpoiltDevice(_half_a_boot_id, "a new low half"),
    "the device skips a seq": SpoiltDevice(_skips_a_seq, "seq increases by 1"),
    "an old STOP makes old frames new": SpoiltDevice(_stop_moves_back, "with any seq"),
    "PONG has a wrong time": SpoiltDevice(_pong_time, "in order"),
    "HELLO does not begin k anew": SpoiltDevice(_k_not_reset, "after a HELLO, any k is new"),
    "noise stops it": SpoiltDevice(_spoilt_stops, "Random bytes"),
}
