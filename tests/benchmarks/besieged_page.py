"""Time until the page's server answers a stop during a siege.

`python -m tests.benchmarks.besieged_page [--n 50] [--busy 4]`

A rig is emulated, and its dashboard is a process of its own that has five minutes of history. In
each row one program besieges one door with its own token: 60 or 200 streams that stay, as many that
reconnect for ever, 300 requests whose body never ends. The owner stops N times, each time by a new
connection. A visitor's stop is timed at the visitors' door, too.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import ssl
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from unittest.mock import patch

import numpy as np
from armrig.dashboard.bins import COLUMNS, WIDTH_S, Rows
from armrig.dashboard.feed import COARSE_S, FINE_S, HISTORY_S, Feed
from armrig.dashboard.serving import Settings, dashboard

from tests.integration.processes import Bench, burning
from tests.integration.watching import Client, endpoint

SIEGES = ("nobody", "stay 60", "stay 200", "again 60", "again 200", "bodies 300", "idle 1000")
_LET_IN_S = 2.0  # before the first stop


def five_minutes() -> Rows:
    """Return as many rows as five minutes leave, which move as the rig does."""
    older = np.arange(-HISTORY_S, -FINE_S, COARSE_S)
    t = np.concatenate([older, np.arange(-FINE_S, 0.0, WIDTH_S)])
    rows = np.empty((t.size, COLUMNS))
    rows[:, 0] = 1e4 + t
    for column in range(1, COLUMNS):
        rows[:, column] = 100 * np.sin(t * column + np.arange(t.size) % 2)
    return rows


def serve(at: str) -> None:
    """Serve a dashboard with a full history until the standard input ends."""
    full = five_minutes()
    live = Feed.history
    with (
        patch.object(Feed, "history", lambda feed: np.concatenate([full, live(feed)])),
        dashboard(Settings(connect=at, port=0, share="127.0.0.1", share_port=0)) as served,
    ):
        print(served.url, served.shared_url, flush=True)
        sys.stdin.read()


def besiege(url: str, kind: str, n: int) -> None:
    """Besiege a door from a line of the standard input on, for ever."""
    print("ready", flush=True)
    sys.stdin.readline()
    asyncio.run(_besiege(Client(url), kind, n))


async def _besiege(door: Client, kind: str, n: int) -> None:
    await asyncio.gather(*(_connection(door, kind) for _ in range(n)))


async def _connection(door: Client, kind: str) -> None:
    head = f"Host: {door.host}:{door.port}\r\nAuthorization: Bearer {door.token}\r\n"
    ask = f"GET /api/stream HTTP/1.1\r\n{head}\r\n"
    if kind == "bodies":
        ask = f"POST /api/stop HTTP/1.1\r\n{head}Content-Length: 1000\r\n\r\n{{"
    if kind == "idle":
        ask = ""
    trusting = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    while True:
        with suppress(OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            reader, writer = await asyncio.open_connection(
                door.host, door.port, ssl=trusting if door.is_shared else None, limit=1 << 24
            )
            writer.write(ask.encode())
            if kind == "again":
                await reader.readuntil(b"event: hello")
            else:
                while await reader.read(1 << 16):
                    pass
            writer.transport.abort()
        await asyncio.sleep(0.001)


@contextmanager
def program(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Give this program with other arguments, until the block ends."""
    with subprocess.Popen(
        [sys.executable, "-m", "tests.benchmarks.besieged_page", *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def stops(doors: dict[str, Client], n: int) -> dict[str, list[float]]:
    """Return the time of each stop, in s, at each door in turn; inf without an answer."""
    found: dict[str, list[float]] = {name: [] for name in doors}
    for name, door in [*doors.items()] * n:
        began = time.monotonic()
        try:
            ok = door.ask("/api/stop", {"owner": "a benchmark"})[0] == 200
        except OSError:
            ok = False
        found[name].append(time.monotonic() - began if ok else np.inf)
        time.sleep(0.05)
    return found


def main() -> None:
    """Print a row for each siege of each door."""
    asked = argparse.ArgumentParser()
    asked.add_argument("--n", type=int, default=50)
    asked.add_argument("--busy", type=int, default=0)
    asked.add_argument("--sieges", nargs="+", default=SIEGES)
    given = asked.parse_args()
    with tempfile.TemporaryDirectory() as folder, burning(given.busy, apart=True):
        bench = Bench(Path(folder))
        try:
            bench.emulate()
            bench.serve()
            with program("serve", endpoint(bench)) as server:
                assert server.stdout
                own, shared = (Client(url) for url in server.stdout.readline().split())
                own.wait("live", lambda seen: not seen["is_stale"])
                for siege in given.sieges:
                    for name, door in (("owner's", own), ("visitors'", shared)):
                        _row(siege, name, door, own, server.pid, given.n)
        finally:
            bench.end()


def _row(siege: str, name: str, door: Client, own: Client, pid: int, n: int) -> None:
    kind, _, size = siege.partition(" ")
    doors = {"owner": own} | ({"visitor": door} if door is not own else {})
    with program("besiege", door.url, kind, size or "0") as besieger:
        assert besieger.stdout
        assert besieger.stdin
        besieger.stdout.readline()
        before, began = _cpu_s(pid), time.monotonic()
        besieger.stdin.write("\n")
        besieger.stdin.flush()
        found = stops(doors, n)
        share = (_cpu_s(pid) - before) / (time.monotonic() - began)
    line = f"{siege:10} at the {name:9}"
    for who, taken in found.items():
        p50, p90, most = np.percentile(taken, [50, 90, 100], method="lower") * 1e3
        line += f"  {who}: p50 {p50:.0f} p90 {p90:.0f} max {most:.0f} ms"
        line += f", {np.count_nonzero(np.isinf(taken))} without answer"
    print(f"{line}  server {share:.0%}  load {os.getloadavg()[0]:.1f}", flush=True)


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    {"serve": serve, "besiege": lambda url, kind, n: besiege(url, kind, int(n))}.get(
        sys.argv[1] if len(sys.argv) > 1 else "", lambda *_: main()
    )(*sys.argv[2:])
