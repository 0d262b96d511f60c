"""Time on the wire: ten bits a byte, one byte after the other."""

from __future__ import annotations

BITS_PER_BYTE = 10  # 8N1: start bit, eight data bits, stop bit


def wire_ns(n_bytes: int, baud: int) -> int:
    """Return how long `n_bytes` take at `baud`, in ns; 0 for baud 0, a wire that takes no time."""
    return n_bytes * BITS_PER_BYTE * 1_000_000_000 // baud if baud else 0


def departure_ns(free_ns: int, now_ns: int, n_bytes: int, baud: int) -> int:
    """Return when the last of `n_bytes` has left, on a wire that is busy until `free_ns`."""
    return max(free_ns, now_ns) + wire_ns(n_bytes, baud)


def arrivals(free_ns: int, now_ns: int, data: bytes, baud: int) -> list[tuple[int, bytes]]:
    """Return the pieces of `data` that end in 00 (and the rest), each with its last byte's arrival.

    The wire is busy until `free_ns`; the last arrival is when it is free again.
    """
    start_ns = max(free_ns, now_ns)
    pieces: list[tuple[int, bytes]] = []
    begin = 0
    while begin < len(data):
        end = data.find(0, begin) + 1 or len(data)
        pieces.append((start_ns + wire_ns(end, baud), data[begin:end]))
        begin = end
    return pieces
