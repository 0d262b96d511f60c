"""What the dashboard costs, and how fast its stop is.

`python tests/benchmarks/dashboard.py stop|stale|viewers|memory`

- stop: from the space bar in chromium to 0 V at the emulated terminals, N times, and by stages.
- stale: from the death of the daemon to a page that says so, N times.
- viewers: lateness of the loop and from sample to subscriber, with ten viewers (one of which never
  reads) and without, in turn.
- memory: heap of the page and resident memory of the server, for MINUTES.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from armrig.dashboard.driver import Driver
from armrig_core.telemetry import Sample

sys.path.insert(0, str(Path(__file__).parents[1] / "integration"))

from driving import bring_to_rest
from playwright.sync_api import sync_playwright
from processes import Bench, wait_for
from watching import Client, watched

N = 20
_TRIES = 5
ROUNDS = 3
ROUND_S = float(os.environ.get("ROUND_S", "20"))
MINUTES = float(os.environ.get("MINUTES", "10"))
VIEWERS = 10
STEP = {"kind": "step", "seconds": 60.0, "at": 0.1, "low": 1.0, "high": 4.0}


@contextmanager
def served() -> Iterator[tuple[Bench, Client]]:
    """Give a rig and its dashboard, whose server is in this process."""
    with _rig() as bench, watched(bench) as client:
        wait_for(lambda: not client.first("live")["is_stale"])
        yield bench, client


@contextmanager
def _rig() -> Iterator[Bench]:
    """Give a rig and its daemon."""
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder))
        bench.configure(watchdog_ms=250)
        try:
            bench.emulate()
            bench.serve()
            yield bench
        finally:
            bench.end()


def told(name: str, values: list[float], unit: str) -> None:
    """Print a distribution."""
    q = np.percentile(values, [50, 90, 100])
    print(f"{name}: n {len(values)}, p50 {q[0]:.1f}, p90 {q[1]:.1f}, max {q[2]:.1f} {unit}")


@contextmanager
def _page(client: Client, *arguments: str) -> Iterator[Any]:
    """Give a page in chromium that shows a rig at rest."""
    with sync_playwright() as started:
        browser = started.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", *arguments]
        )
        page = browser.new_page()
        page.goto(client.url)
        page.wait_for_selector(".pill.safe")
        yield page
        browser.close()


def _begin(bench: Bench, client: Client) -> None:
    """Drive the motor; again from rest where this machine stalls, and the run is ended for it."""
    for _ in range(_TRIES):
        client.ask("/api/run", {"owner": "a benchmark", "experiment": STEP})
        wait_for(lambda: bench.volts() > 0 or client.first("run")["error"], 20)
        if bench.volts() > 0:
            return
        bring_to_rest(bench)
    sys.exit(f"no run begins: {client.first('run')['error']}")


STAGES = ("key to 0 V", "key to the page", "page to the server", "server to 0 V")


def stop() -> None:
    """Measure the way of a stop, from what is asked of chromium on."""
    times: list[list[float]] = [[] for _ in STAGES]
    at_server = [0]
    stopped = Driver.stop

    def noted(driver: Driver, by: str) -> None:
        at_server[0] = time.monotonic_ns()
        stopped(driver, by)

    with served() as (bench, client), _page(client) as page, patch.object(Driver, "stop", noted):
        devtools = page.context.new_cdp_session(page)
        devtools.send("Runtime.evaluate", {"expression": _NOTES_KEY})
        for _ in range(N):
            _begin(bench, client)
            page.wait_for_timeout(300)
            pressed = time.monotonic_ns()
            page.keyboard.press("Space")
            total_s = bench.went_to_0_v_after(pressed)
            answer = devtools.send("Runtime.evaluate", {"expression": "keyAt"})
            at_page = answer["result"]["value"] * 1e6 - time.time_ns() + time.monotonic_ns()
            at_end = pressed + total_s * 1e9
            marks = (pressed, at_page, at_server[0], at_end)
            stages = [b - a for a, b in itertools.pairwise(marks)]
            for kept, ns in zip(times, (at_end - pressed, *stages), strict=True):
                kept.append(ns / 1e6)
            wait_for(lambda: not client.first("run")["is_going"])
    for name, kept in zip(STAGES, times, strict=True):
        told(name, kept, "ms")


_NOTES_KEY = """
let keyAt = 0;
addEventListener("keydown", () => (keyAt = performance.timeOrigin + performance.now()), true);
"""


def stale() -> None:
    """Measure how long a page takes to say that its daemon is dead."""
    times: list[float] = []
    with served() as (bench, client), _page(client) as page:
        for _ in range(N // 4):
            died = bench.processes[-1].kill()
            page.wait_for_selector(".pill.stale")
            times.append((time.monotonic_ns() - died) / 1e6)
            bench.processes[-1].popen.wait(10)
            bench.serve()
            page.wait_for_selector(".pill.safe", timeout=60_000)
    told("death of the daemon to stale", times, "ms")


def _round(bench: Bench) -> tuple[float, float]:
    """Return p99 of the loop's lateness, and of sample to subscriber, in µs."""
    late: list[float] = []
    heard: list[float] = []
    with bench.rig() as rig, rig.arrivals("timing") as reports:
        until = time.monotonic() + ROUND_S
        for sample in rig.stream("sample"):
            if isinstance(sample, Sample):
                heard.append((time.monotonic_ns() - sample.t_host_ns) / 1e3)
            late += [report.wake_lateness_us.p99 for report in reports()]
            if time.monotonic() > until:
                break
    return statistics.median(late), float(np.percentile(heard, 99))


def watch(url: str) -> None:
    """Be ten viewers, one of whom never reads, until the standard input ends."""
    client = Client(url)
    seen = [threading.Event() for _ in range(VIEWERS - 1)]

    def read(first: threading.Event) -> None:
        for _ in client.events():
            first.set()

    with socket.create_connection((client.host, client.port)) as deaf:
        head = f"GET /api/stream HTTP/1.1\r\nHost: {client.host}:{client.port}\r\n"
        deaf.sendall(f"{head}Authorization: Bearer {client.token}\r\n\r\n".encode())
        for first in seen:
            threading.Thread(target=read, args=(first,), daemon=True).start()
        for first in seen:
            first.wait()
        print("watching", flush=True)
        sys.stdin.read()


@contextmanager
def _watching(url: str) -> Iterator[None]:
    """Have ten viewers in a process of their own."""
    with subprocess.Popen(
        [sys.executable, __file__, "watch", url],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin
        assert process.stdout
        process.stdout.readline()
        yield
        process.stdin.close()


@contextmanager
def _dashboard(bench: Bench) -> Iterator[str]:
    """Give the address of a dashboard that is a process of its own."""
    with subprocess.Popen(
        [sys.executable, "-m", "armrig", "dashboard", "--json"],
        env={**os.environ, "XDG_RUNTIME_DIR": str(bench.folder)},
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout
        try:
            yield str(json.loads(process.stdout.readline())["url"])
        finally:
            process.kill()


def viewers() -> None:
    """Compare rounds with and without viewers of a dashboard, which is a process of its own."""
    with _rig() as bench, _dashboard(bench) as url:
        client = Client(url)
        wait_for(lambda: not client.first("live")["is_stale"])
        for _ in range(ROUNDS):
            alone = _round(bench)
            with _watching(url):
                watched_by_ten = _round(bench)
                left = client.first("timing")["viewers"] - 1  # without who asks
            print(f"p99 of lateness, to subscriber [µs]: alone {alone}, ten {watched_by_ten}")
            print(f"of {VIEWERS} viewers {left} are left: who does not read is dropped", flush=True)


def memory() -> None:
    """Tell heap and resident memory once a minute."""
    with served() as (_, client), _page(client) as page:
        devtools = page.context.new_cdp_session(page)
        for minute in range(int(MINUTES) + 1):
            page.wait_for_timeout(60_000 if minute else 2_000)
            devtools.send("HeapProfiler.collectGarbage")
            heap = devtools.send("Runtime.getHeapUsage")["usedSize"] / 1e6
            resident = int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6
            print(f"{minute} min: page {heap:.2f} MB, server {resident:.1f} MB", flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "watch":
        watch(sys.argv[2])
    else:
        {"stop": stop, "stale": stale, "viewers": viewers, "memory": memory}[sys.argv[1]]()
