"""Rules of section 1: bytes, and dropped frames."""

from __future__ import annotations

from zlib import crc32

from armrig_protocol import cobs, frame
from armrig_protocol import messages as wire
from armrig_protocol.messages import TYPES

from armrig_daemon.conformance.host import Broken, LineHost
from armrig_daemon.conformance.rule import expect, rule

_STATUS_MS = 3_000
UNKNOWN_TYPE = 0x7E


def frame_bytes(text: bytes, *, wrong: int = 0) -> bytes:
    """Return a frame with the contents `text`; each bit set in `wrong` is inverted in the CRC."""
    return cobs.stuff(text + (crc32(text) ^ wrong).to_bytes(4, "little")) + b"\0"


def header(number: int, seq: int) -> bytes:
    """Return the header of a host's frame."""
    return bytes((number, 0)) + (seq & 0xFFFF).to_bytes(2, "little")


def bad_frames(host: LineHost) -> list[bytes]:
    """Return frames that a device must drop: wrong CRCs, wrong lengths, wrong stuffing."""
    keepalive = header(TYPES[wire.Keepalive], host.seq + 1)
    sound = frame.encode(wire.Ping(0, (host.seq + 1) & 0xFFFF, 7))
    return [
        *(
            frame_bytes(header(TYPES[wire.Ping], host.seq + 1) + bytes(8), wrong=1 << bit)
            for bit in (0, 11, 22, 31)
        ),
        frame_bytes(keepalive + b"\1"),
        frame_bytes(header(TYPES[wire.Ping], host.seq + 1) + bytes(7)),
        b"\x7f" + sound[1:],
    ]


@rule(
    1, "A frame with a wrong CRC, a wrong length or wrong stuffing is dropped, and never answered"
)
def _drop_bad_frames(host: LineHost) -> None:
    for data in bad_frames(host):
        host.write(data)
        answers = host.fence()
        expect(not answers, answers)


@rule(1, "Each type has one length: HELLO without its last byte is dropped")
def _stale_hello_length(host: LineHost) -> None:
    host.write(frame_bytes(header(TYPES[wire.Hello], host.seq + 1) + bytes(5)))
    answers = host.fence()
    expect(not answers, answers)


@rule(1, "A piece longer than any frame is dropped; the next frame is accepted")
def _too_long(host: LineHost) -> None:
    host.write(bytes(range(1, 256)) + b"\0")
    answers = host.fence()
    expect(not answers, answers)


@rule(1, "A frame may arrive in any pieces")
def _cut(host: LineHost) -> None:
    host.seq = (host.seq + 1) & 0xFFFF
    messages: list[wire.Message] = []
    for byte in frame.encode(wire.Ping(0, host.seq, 2**63)):
        host.write(bytes((byte,)))
        messages += host.listen(1)
    messages += host.fence()
    answered = [m for m in messages if isinstance(m, wire.Pong) and m.host_ns == 2**63]
    expect(len(answered) == len(messages) == 1, messages)


@rule(1, "A lost 00 costs two frames, but not the third")
def _missing_delimiter(host: LineHost) -> None:
    first = frame.encode(wire.Ping(0, (host.seq + 1) & 0xFFFF, 1))
    second = frame.encode(wire.Ping(0, (host.seq + 2) & 0xFFFF, 2))
    host.write(first[:-1] + second)
    answers = host.fence()
    expect(not answers, answers)


@rule(1, "Empty frames are ignored, and not counted", silent=True)
def _empty(host: LineHost) -> None:
    before = next_status(host)
    host.write(bytes(40))
    answers = host.fence()
    expect(not answers, answers)
    more = next_status(host).spoilt - before.spoilt
    expect(more == 0, f"{more} counted as spoilt")


@rule(1, "STATUS counts received, spoilt and refused frames", silent=True)
def _status_counters(host: LineHost) -> None:
    before = next_status(host)
    spoilt = bad_frames(host)
    for data in spoilt:
        host.write(data)
    host.write(frame_bytes(header(UNKNOWN_TYPE, host.seq + 1)))
    host.fence()
    after = next_status(host)
    frames, refused = after.frames - before.frames, after.refused - before.refused
    grew = (frames, after.spoilt - before.spoilt, refused)
    expect(grew == (2, len(spoilt), 1), f"frames, spoilt, refused grew by {grew}")


def next_status(host: LineHost) -> wire.Status:
    """Return the next STATUS, which the device sends once a second; the host stays silent."""
    host.status = None
    for _ in range(_STATUS_MS // 20):
        host.listen(20)
        status: wire.Status | None = host.status  # listening has set it
        if status is not None:
            return status
    raise Broken(f"no STATUS in {_STATUS_MS / 1000:g} s")
