"""The command decoder: any bytes give a command within its limits, or a `ValueError`."""

from __future__ import annotations

from collections import Counter
from math import inf, isfinite
from random import Random

from armrig_core.commands.commands import (
    REQUESTS,
    CalibrateRequest,
    Requests,
    RunRequest,
    SetRequest,
    parse,
)
from armrig_core.rig.volts import U_MAX_V

from tests.fuzz.mutation import mutated

_LEASE = b'"lease": "0123456789abcdef0123456789abcdef", "n": 7'
CORPUS = [
    ("status", b"{}"),
    ("arm", b'{"owner": "a student"}'),
    ("arm", b'{"owner": "a student", "Ts": 0.005}'),
    ("note", b'{"text": "the arm was touched", "owner": "Ada"}'),
    ("renew", b"{%s}" % _LEASE),
    ("set", b'{%s, "u": 2.5}' % _LEASE),
    ("run", b'{%s, "u": [0, 1.5, 5.0, 4e0], "pacing": "exchange"}' % _LEASE),
    (
        "run",
        b'{%s, "u": [1, 2], "experiment": "black-box", "details": {"seed": 1}, "dead_man": 1.5}'
        % _LEASE,
    ),
    (
        "calibrate",
        b'{"calibration": {"theta_1": {"zero_counts": 8000.5, "rad_per_count": -9e-5, "wraps": '
        b'true}, "driver": {"gain": 1.02, "offset_v": -0.1}, "made": {"date": "2026-11-20", "rig": '
        b'"1", "device_uid": "1", "armrig": "0.2"}}, "raw": "AAAA"}',
    ),
]
_PAYLOADS = [data for _, data in CORPUS]
_NAMES = [*REQUESTS, "", "armed", "run\0", "../run"]
_TOKENS = [
    *(b"NaN", b"Infinity", b"-Infinity", b"1e999", b"-0.0", b"5.0000000000000001", b"-1e-300"),
    *(b"null", b"true", b'"3"', b"[]", b"{}", b"1" * 400, b"0." + b"1" * 400, b'"\\u0000"'),
    *(b'"../../x"', b'"\\ud800"', b'"\xff\xfe"', b"[" * 2000, b'{"u":' * 500),
    *(b"18446744073709551616", b'"x": 1', b'"u": 6', b'"n": -1', b'"n": 9007199254740992'),
]


def command(rng: Random) -> tuple[str, bytes]:
    """Return a command's name and fields, changed in bytes or in tokens."""
    name, data = rng.choice(CORPUS)
    if rng.random() < 0.1:
        name = rng.choice(_NAMES)
    of = rng.random()
    if of < 0.5:
        return name, mutated(data, rng, _PAYLOADS)
    parts = data.replace(b",", b" , ").replace(b":", b" : ").replace(b"}", b" }").split(b" ")
    for _ in range(rng.choice((1, 1, 2))):
        parts[rng.randrange(len(parts))] = rng.choice(_TOKENS)
    data = b" ".join(parts)
    return name, data if of < 0.9 else mutated(data, rng, _PAYLOADS)


def check(request: Requests) -> None:
    """Assert that an accepted command is allowed: S1 at the first of its gates."""
    if isinstance(request, SetRequest):
        assert 0.0 <= request.u <= U_MAX_V, request.u
    if isinstance(request, CalibrateRequest):
        for pot in (request.calibration.theta_1, request.calibration.alpha):
            assert isfinite(pot.zero_counts), pot
            assert 0 < abs(pot.rad_per_count) < inf, pot
        driver = request.calibration.driver
        assert 0.1 <= driver.gain <= 10, driver
        assert abs(driver.offset_v) <= U_MAX_V, driver
    if isinstance(request, RunRequest):
        assert request.u
        assert all(0.0 <= volts <= U_MAX_V for volts in request.u), request.u
        assert not set(request.experiment) - set("abcdefghijklmnopqrstuvwxyz0123456789-")


def fuzz(most: int, seed: int) -> Counter[str]:
    """Parse `most` payloads; return how many were taken and refused."""
    rng = Random(seed)
    found: Counter[str] = Counter()
    for _ in range(most):
        name, data = command(rng)
        found["inputs"] += 1
        try:
            request = parse(name, data)
        except ValueError as err:
            found["refused"] += 1
            told = str(err)
        else:
            check(request)
            found["taken"] += 1
            told = ""
        assert len(told) < 1000, told[:200]
    return found
