"""Attempts without permission: 100 000 messages on 1000 connections, and a flood.

`python -m tests.benchmarks.access` as root; it takes five minutes. First clients without permission
besiege a daemon from a network namespace of their own, while an operator watches. The control is a
shorter siege without access control, which succeeds. Finally the lateness of the loop is measured,
in turn for an idle daemon and for a daemon that an observer floods.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from armrig.rig.client import Rig
from numpy.typing import NDArray

from tests.integration import namespaces, remote_rig
from tests.integration.laboratory import by_certificate, certificates
from tests.integration.namespaces import Namespaces
from tests.integration.processes import Bench

BESIEGER = "tests.integration.besieger"
LET_IN, NOT_LET_IN = ("wrong", "eve", "bob"), ("forged", "expired")
_SIEGE_S = 400.0
Lateness = tuple[float, float, float]


def besieged(line: Namespaces, program: tuple[str, ...], connections: int, messages: int) -> None:
    """Attack a daemon as each client, and print the results."""
    with tempfile.TemporaryDirectory(prefix="armrig-") as folder:
        bench = Bench(Path(folder))
        made = certificates(bench.folder)
        where = by_certificate(bench, made, f"tls/{namespaces.ADDRESSES['rig']}:{remote_rig.PORT}")
        total: Counter[str] = Counter()
        try:
            bench.emulate()
            with remote_rig.started(line, bench, *program) as log:
                with remote_rig.watching(line, where, made) as watcher:
                    for who in (*LET_IN, *NOT_LET_IN):
                        share = connections // (3 if who in LET_IN else 10)
                        found = _told(line, where, made, who, f"{share} {messages}")
                        print(f"  {who:8} {json.dumps(found)}", flush=True)
                        total.update(found)
                watched = remote_rig.said(watcher)
                by = [text for text in log.read_text().splitlines() if ": by " in text]
        finally:
            bench.end()
    print(
        f"  {total['messages']} messages on {total['links']} links of {total['connections']} "
        f"connections: {total['replies']} commands answered, {total['heard']} samples heard; the "
        f"daemon's log names {len(by)} commands; a watcher heard {sum(watched['heard'].values())} "
        f"messages of the rig and {sum(watched['forged'].values())} forged ones"
    )


def _told(line: Namespaces, where: str, made: Path, who: str, what: str) -> Any:
    program = remote_rig.stranger(line, where, made, who, f"{who}.pem", BESIEGER)
    text, _ = program.communicate(what + "\n", timeout=_SIEGE_S)
    return json.loads(text)


def flooded(line: Namespaces, rounds: int, seconds: float) -> None:
    """Print how late the loop wakes alone and flooded, in turns, and the ratio of each round."""
    with tempfile.TemporaryDirectory(prefix="armrig-") as folder:
        bench = Bench(Path(folder))
        made = certificates(bench.folder)
        where = by_certificate(bench, made, f"tls/{namespaces.ADDRESSES['rig']}:{remote_rig.PORT}")
        try:
            bench.emulate()
            with remote_rig.started(line, bench, *remote_rig.GUARDED):
                lateness = [_round(bench, line, where, made, seconds) for _ in range(rounds)]
        finally:
            bench.end()
    alone, under, elsewhere = (np.array(part) for part in zip(*lateness, strict=True))
    for name, column in (("p50", 0), ("p99", 1), ("worst", 2)):
        a, u, e = alone[:, column], under[:, column], elsewhere[:, column]
        print(
            f"  wake lateness, {name}: alone {_spread(a)} µs, flooded {_spread(u)} µs, beside "
            f"another program that is flooded {_spread(e)} µs; ratio of the last two "
            f"{_spread(u / e)}, n = {rounds}"
        )


def _spread(values: NDArray[np.float64]) -> str:
    return f"{np.median(values):.2f} ({values.min():.2f} to {values.max():.2f})"


def _round(
    bench: Bench, line: Namespaces, where: str, made: Path, seconds: float
) -> tuple[Lateness, Lateness, Lateness]:
    """Return p50 and p99 of a daemon alone, flooded, and next to a flooded program."""
    alone = _lateness(bench, seconds)
    under = _flooded_lateness(bench, line, where, made, seconds)
    beside = f"tls/{namespaces.ADDRESSES['rig']}:{remote_rig.PORT + 1}"
    program = remote_rig.HERE / "zenoh_burner.py"
    burner = subprocess.Popen(
        line.command("rig", sys.executable, str(program), beside, str(made / "rig-1.pem")),
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert burner.stdout is not None
        burner.stdout.readline()
        elsewhere = _flooded_lateness(bench, line, beside, made, seconds)
    finally:
        burner.kill()
        burner.communicate()
    return alone, under, elsewhere


def _flooded_lateness(
    bench: Bench, line: Namespaces, where: str, made: Path, seconds: float
) -> Lateness:
    flood = remote_rig.stranger(line, where, made, "bob", "bob.pem", BESIEGER)
    assert flood.stdin is not None
    flood.stdin.write(f"flood {seconds + 2}\n")
    flood.stdin.flush()
    try:
        return _lateness(bench, seconds)
    finally:
        flood.communicate(timeout=_SIEGE_S)


def _lateness(bench: Bench, seconds: float) -> Lateness:
    """Return the wake lateness in µs: medians over the seconds of p50 and p99, and the worst."""
    with bench.rig() as rig:
        told = _timing(rig, round(seconds))
    p50, p99 = np.median([t.p50 for t in told]), np.median([t.p99 for t in told])
    return float(p50), float(p99), max(t.max for t in told)


def _timing(rig: Rig, n: int) -> list[Any]:
    stream = rig.stream("timing")
    next(stream)  # begun before
    return [next(stream).wake_lateness_us for _ in range(n)]


def main() -> None:
    """Run all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--connections", type=int, default=1200)
    parser.add_argument("--messages", type=int, default=100)
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    if why := namespaces.missing():
        raise SystemExit(why)
    with namespaces.connected() as line:
        print("guarded")
        besieged(line, remote_rig.GUARDED, given.connections, given.messages)
        print("the control: access control and client certificates taken away")
        besieged(line, remote_rig.UNGUARDED, 30, given.messages)
        print("a flood, with payloads of 7 and 9 MB in it")
        flooded(line, given.rounds, 5.0)


if __name__ == "__main__":
    main()
