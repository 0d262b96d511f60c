"""Ten bits a byte, one after the other."""

from __future__ import annotations

from armrig_daemon.emulator.uart import arrivals, departure_ns, wire_ns
from hypothesis import given
from hypothesis import strategies as st


def test_a_byte_takes_ten_bits() -> None:
    """At 1 Mbaud 16 bytes take 160 µs, at 500 kbaud twice that."""
    assert wire_ns(16, 1_000_000) == 160_000
    assert wire_ns(16, 500_000) == 320_000
    assert wire_ns(16, 0) == 0


def test_bytes_wait_for_earlier_bytes() -> None:
    assert departure_ns(500_000, 100_000, 1, 1_000_000) == 510_000
    assert departure_ns(100_000, 500_000, 1, 1_000_000) == 510_000


def test_a_frame_arrives_with_its_last_byte() -> None:
    pieces = arrivals(0, 1_000, b"ab\0\0c", 1_000_000)

    assert pieces == [(31_000, b"ab\0"), (41_000, b"\0"), (51_000, b"c")]


@given(st.binary(max_size=200), st.integers(0, 10**6), st.sampled_from([0, 115_200, 500_000]))
def test_bytes_are_neither_lost_nor_reordered(data: bytes, free_ns: int, baud: int) -> None:
    pieces = arrivals(free_ns, 1_000, data, baud)

    assert b"".join(piece for _, piece in pieces) == data
    assert [t for t, _ in pieces] == sorted(t for t, _ in pieces)
