"""The C core's frames: the golden vectors, and the Python codec on any bytes."""

from __future__ import annotations

import ctypes
import json
from pathlib import Path
from typing import Any
from zlib import crc32

import pytest
from armrig_core.rig.volts import duty
from armrig_daemon.emulator.board import pin_code
from armrig_daemon.emulator.firmware import Hardware
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol import cobs, decoder, frame
from armrig_protocol.decoder import MAX_STUFFED
from armrig_protocol.frame import Spoilt, Unknown
from armrig_protocol.messages import MAX_DECODED
from hypothesis import given
from hypothesis import strategies as st

from tests.firmware import library
from tests.firmware.core_device import CoreDevice
from tests.sampling import sampled
from tests.tools import needs

pytestmark = needs("cc", "make")

VECTORS = json.loads(
    (Path(__file__).parents[2] / "firmware_protocol" / "vectors" / "frames.json").read_text()
)
OPENED = ["sound", "unknown", "cobs", "length", "crc"]
NO_ZERO = st.binary(max_size=80).map(lambda b: b.replace(b"\0", b"\1"))


def hardware(pwm_bits: int = 10) -> Hardware:
    """Return a board of `pwm_bits`."""
    return Hardware(conversion_ns=104_000, hold_ns=12_000, adc_bits=10, pwm_bits=pwm_bits, queue=64)


def core() -> Any:
    return library.library(hardware()).functions


def opened(stuffed: bytes) -> tuple[str, bytes]:
    """Return the core's result for the bytes between two 00, and their text."""
    text = ctypes.create_string_buffer(MAX_DECODED)
    kind = OPENED[core().pc_open(stuffed, min(len(stuffed), MAX_STUFFED + 1), text)]
    return kind, text.raw[: len(stuffed) - 1]


def closed(text: bytes) -> bytes:
    """Return a message, given without CRC, as the core sends it."""
    wire = ctypes.create_string_buffer(MAX_DECODED + 2)
    n = core().pc_close(text + bytes(4), len(text) + 4, wire)
    return wire.raw[:n]


def kind_of(received: decoder.Received) -> str:
    """Return the core's kind of a frame."""
    if isinstance(received, Spoilt):
        return received.reason
    return "unknown" if isinstance(received, Unknown) else "sound"


@pytest.mark.parametrize("vector", VECTORS, ids=[v["doc"] for v in VECTORS])
def test_the_core_matches_the_golden_vectors(vector: dict[str, Any]) -> None:
    wire = bytes.fromhex(vector["wire"])
    expected = [
        {"Spoilt": e.get("reason"), "Unknown": "unknown"}.get(e["event"], "sound")
        for e in vector["events"]
    ]

    stuffed = [piece for piece in wire.split(b"\0")[:-1] if piece]

    assert [opened(piece)[0] for piece in stuffed] == expected
    for piece in stuffed:
        kind, text = opened(piece)
        if kind == "sound":
            assert closed(text[:-4]) == piece + b"\0"


@pytest.mark.parametrize("bit", range(32))
def test_a_flipped_bit_of_the_crc_spoils_the_frame(bit: int) -> None:
    text = bytes((0x13, 0, 1, 0))

    kind, _ = opened(cobs.stuff(text + (crc32(text) ^ 1 << bit).to_bytes(4, "little")))

    assert kind == "crc"


@given(st.binary(max_size=255))
def test_the_crc_equals_that_of_zlib(text: bytes) -> None:
    assert core().rig_crc(text, len(text)) == crc32(text)


@given(st.binary(max_size=cobs.MAX_TEXT))
def test_stuffing_equals_that_of_python(text: bytes) -> None:
    place = ctypes.create_string_buffer(b"\xaa" + text, len(text) + 1)

    core().rig_stuff(place, len(text) + 1)
    assert place.raw == cobs.stuff(text)

    assert core().rig_unstuff(place, len(text) + 1)
    assert place.raw[1:] == text


@given(NO_ZERO.filter(bool))
def test_any_bytes_are_decoded_like_in_python(stuffed: bytes) -> None:
    _, (received,) = decoder.feed(b"", stuffed + b"\0")

    assert opened(stuffed)[0] == kind_of(received)


@given(
    st.lists(
        st.one_of(
            st.binary(max_size=80),
            st.sampled_from([bytes.fromhex(v["wire"]) for v in VECTORS]),
            st.binary(min_size=4, max_size=70).map(
                lambda t: cobs.stuff(t + crc32(t).to_bytes(4, "little")) + b"\0"
            ),
        ),
        max_size=8,
    ),
    st.randoms(use_true_random=False),
)
def test_the_decoded_frames_do_not_depend_on_how_the_line_cuts_them(
    parts: list[bytes], rng: Any
) -> None:
    stream = b"".join(parts) + b"\0"
    _, received = decoder.feed(b"", stream)
    spoilt = sum(isinstance(item, Spoilt) for item in received)
    device = CoreDevice(EmulatorSettings(boot_ms=0.0, queue=64), 0)
    device.advance(0)
    c = device.use()

    at = 0
    while at < len(stream):
        n = rng.randint(1, 40)
        piece = stream[at : at + n]
        c.pc_receive(piece, len(piece))
        at += n

    assert c.pc_spoilt() == spoilt
    lost = c.pc_rx_lost() // frame.wire_length(frame.MESSAGES[0x10])
    assert c.pc_frames() + lost == len(received) - spoilt


@pytest.mark.parametrize("bits", sampled([8, 10, 12, 15]))
def test_duty_and_code_equal_those_of_python(bits: int) -> None:
    c = library.library(hardware(bits)).functions

    for u in range(0, 65536, 1 if bits == 10 else 31):
        steps = duty(u, bits)
        assert c.rig_duty(u) == steps
        assert c.rig_code(steps) == pin_code(u, bits)
