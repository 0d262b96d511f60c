"""The frame decoder: any bytes, cut anywhere, give messages, `Unknown` and `Spoilt`."""

from __future__ import annotations

from collections import Counter
from random import Random
from struct import Struct, pack
from zlib import crc32

from armrig_protocol import cobs
from armrig_protocol.decoder import MAX_STUFFED, feed
from armrig_protocol.frame import encode
from armrig_protocol.messages import LAYOUTS, MESSAGES

from tests.fuzz.mutation import mutated

_BATCH = 64
_CLASSES = tuple(MESSAGES.values())
_SIZES = {number: Struct("<" + layout).size for number, layout in LAYOUTS.items()}


def _framed(text: bytes) -> bytes:
    return cobs.stuff(text + pack("<I", crc32(text))) + b"\0"


def _sound(rng: Random) -> bytes:
    """Return a frame whose check sum is right; its length and its fields may be wrong."""
    number = rng.choice([*_SIZES, rng.randrange(256)])
    size = _SIZES.get(number, rng.randrange(80)) if rng.random() < 0.8 else rng.randrange(80)
    return _framed(bytes((number,)) + rng.randbytes(size))


def stream(rng: Random, corpus: list[bytes]) -> bytes:
    """Return some frames, sound and spoilt, with noise among them."""
    frames = []
    for _ in range(_BATCH):
        of = rng.random()
        frame = _sound(rng) if of < 0.6 else rng.choice(corpus)
        if of > 0.25:
            frame = mutated(frame, rng, corpus)
        if of > 0.97:
            frame = rng.randbytes(rng.randrange(4 * MAX_STUFFED))
        frames.append(frame)
    return b"".join(frames)


def fuzz(most: int, seed: int) -> Counter[str]:
    """Feed about `most` bytes; return how many, and what came out, by kind."""
    rng = Random(seed)
    corpus = [_framed(bytes((n,)) + bytes(size)) for n, size in _SIZES.items()]
    found: Counter[str] = Counter()
    pending = b""
    while found["bytes"] < most:
        data = stream(rng, corpus)
        found["bytes"] += len(data)
        at = 0
        while at < len(data):
            piece = data[at : at + rng.choice((1, 7, 64, 2048))]
            at += len(piece)
            pending, received = feed(pending, piece)
            assert len(pending) <= MAX_STUFFED + 1, len(pending)
            for message in received:
                found[type(message).__name__] += 1
                if isinstance(message, _CLASSES) and rng.random() < 0.02:
                    assert feed(b"", encode(message)) == (b"", [message])
    return found
