"""Valid bytes made invalid, by a seeded generator: the same seed gives the same inputs."""

from __future__ import annotations

import struct
from random import Random

_NUMBERS = [0, 1, 2**7, 2**15, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1]
_EXTREMES = [struct.pack("<Q", number)[:size] for number in _NUMBERS for size in (1, 2, 4, 8)]


def mutated(data: bytes, rng: Random, corpus: list[bytes]) -> bytes:
    """Return `data` with one to four changes; `corpus` is what pieces are taken from."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        _CHANGES[int(rng.random() * len(_CHANGES))](changed, rng, corpus)
    return bytes(changed)


def _place(data: bytearray, rng: Random) -> int:
    return int(rng.random() * (len(data) + 1))


def _flip(data: bytearray, rng: Random, _: list[bytes]) -> None:
    if data:
        data[_place(data, rng) - 1] ^= 1 << int(rng.random() * 8)


def _overwrite(data: bytearray, rng: Random, _: list[bytes]) -> None:
    at, number = _place(data, rng), rng.choice(_EXTREMES)
    data[at : at + len(number)] = number


def _insert(data: bytearray, rng: Random, _: list[bytes]) -> None:
    at = _place(data, rng)
    data[at:at] = rng.randbytes(int(rng.random() * 16))


def _delete(data: bytearray, rng: Random, _: list[bytes]) -> None:
    at = _place(data, rng)
    del data[at : at + int(rng.random() * 32)]


def _cut(data: bytearray, rng: Random, _: list[bytes]) -> None:
    del data[_place(data, rng) :]


def _repeat(data: bytearray, rng: Random, _: list[bytes]) -> None:
    at = _place(data, rng)
    data[at:at] = data[at : at + int(rng.random() * 64)] * int(1 + rng.random() * 3)


def _splice(data: bytearray, rng: Random, corpus: list[bytes]) -> None:
    other = rng.choice(corpus)
    data[_place(data, rng) :] = other[int(rng.random() * len(other)) :]


_CHANGES = (_flip, _flip, _overwrite, _insert, _delete, _cut, _repeat, _splice)
