"""What the dashboard costs, and how fast its stop is.

`PYTHONPATH=tests/integration python tests/benchmarks/dashboard.py stop|viewers|memory`

- stop: from the space bar in chromium to 0 V at the emulated terminals, N times.
- viewers: lateness of the loop and from sample to subscriber, with ten viewers (one of which never
  reads) and without, in turn.
- memory: heap of the page and resident memory of the server, for MINUTES.
"""

from __future__ import annotations

import os
import shutil
import socket
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from armrig_core.telemetry import Sample
from playwright.sync_api import sync_playwright
from processes import Bench, wait_for
from watching import Client, watched

N = 20
ROUNDS = 3
ROUND_S = 20.0
MINUTES = float(os.environ.get("MINUTES", "10"))
VIEWERS = 10
STEP = {"kind": "step", "seconds": 60.0, "at": 0.1, "low": 1.0, "high": 4.0}


@contextmanager
def served() -> Iterator[tuple[Bench, Client]]:
    """Give a rig and its dashboard."""
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder))
        bench.configure(watchdog_ms=250)
        try:
            bench.emulate()
            bench.serve()
            with watched(bench) as client:
                wait_for(lambda: not client.first("live")["is_stale"])
                yield bench, client
        finally:
            bench.end()


def told(name: str, values: list[float], unit: str) -> None:
    """Print a distribution."""
    q = np.percentile(values, [50, 90, 100])
    print(f"{name}: n {len(values)}, p50 {q[0]:.1f}, p90 {q[1]:.1f}, max {q[2]:.1f} {unit}")


def stop() -> None:
    """Measure the way of a stop."""
    times: list[float] = []
    with served() as (bench, client), sync_playwright() as started:
        browser = started.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        page = browser.new_page()
        page.goto(client.url)
        page.wait_for_selector(".pill.safe")
        while len(times) < N:
            client.ask("/api/run", {"owner": "a benchmark", "experiment": STEP})
            try:
                wait_for(lambda: bench.volts() > 0, 5)
            except AssertionError:  # refused, as this machine stalls
                continue
            page.wait_for_timeout(300)
            pressed = time.monotonic_ns()
            page.keyboard.press("Space")
            times.append(bench.went_to_0_v_after(pressed) * 1e3)
            wait_for(lambda: not client.first("run")["is_going"])
        browser.close()
    told("key to 0 V", times, "ms")


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


@contextmanager
def _watching(client: Client) -> Iterator[None]:
    ends = threading.Event()

    def watch() -> None:
        for _ in client.events():
            if ends.is_set():
                return

    threads = [threading.Thread(target=watch) for _ in range(VIEWERS - 1)]
    with socket.create_connection((client.host, client.port)) as deaf:
        head = f"GET /api/stream HTTP/1.1\r\nHost: {client.host}:{client.port}\r\n"
        deaf.sendall(f"{head}Authorization: Bearer {client.token}\r\n\r\n".encode())
        for thread in threads:
            thread.start()
        yield
        ends.set()
        for thread in threads:
            thread.join()


def viewers() -> None:
    """Compare rounds with and without viewers."""
    with served() as (bench, client):
        for _ in range(ROUNDS):
            alone = _round(bench)
            with _watching(client):
                watched_by_ten = _round(bench)
            print(f"p99 of lateness, to subscriber [µs]: alone {alone}, ten {watched_by_ten}")


def memory() -> None:
    """Tell heap and resident memory once a minute."""
    with served() as (_, client), sync_playwright() as started:
        browser = started.chromium.launch(
            executable_path=shutil.which("chromium"),
            args=["--no-sandbox", "--enable-precise-memory-info", "--js-flags=--expose-gc"],
        )
        page = browser.new_page()
        page.goto(client.url)
        link = page.context.new_cdp_session(page)
        for minute in range(int(MINUTES) + 1):
            page.wait_for_timeout(60_000 if minute else 2_000)
            link.send("HeapProfiler.collectGarbage")
            heap = link.send("Runtime.getHeapUsage")["usedSize"] / 1e6
            resident = int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6
            print(f"{minute} min: page {heap:.2f} MB, server {resident:.1f} MB", flush=True)
        browser.close()


if __name__ == "__main__":
    {"stop": stop, "viewers": viewers, "memory": memory}[sys.argv[1]]()
