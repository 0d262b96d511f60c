"""Times of bytes on the wire: ten bits per byte, one byte at a time."""

from __future__ import annotations

BITS_PER_BYTE = 10  # 8N1: start bit, eight data bits, stop bit


def wire_ns(n_bytes: int, baud: int) -> int:
    """Return the time that `n_bytes` take on the wire, in ns; with baud 0, bytes take no time."""
    return n_bytes * BITS_PER_BYTE * 1_000_000_000 // baud if baud else 0


def departure_ns(free_ns: int, now_ns: int, n_bytes: int, baud: int) -> int:
    """Return the time at which `n_bytes` have been sent on a wire that is busy until `free_ns`."""
    return max(free_ns, now_ns) + wire_ns(n_bytes, baud)


def arrivals(free_ns: int, now_ns: int, data: bytes, baud: int) -> list[tuple[int, bytes]]:
    """Split `data` after each 00; return the arrival time and the bytes of each piece.

    The bytes after the last 00 are the last piece. A piece arrives when its last byte arrives.
    Earlier bytes occupy the wire until `free_ns`; `data` occupies the wire until the last returned
    time.
    """
    start_ns = max(free_ns, now_ns)
    pieces: list[tuple[int, bytes]] = []
    begin = 0
    while begin < len(data):
        end = data.find(0, begin) + 1 or len(data)
        pieces.append((start_ns + wire_ns(end, baud), data[begin:end]))
        begin = end
    return pieces
