"""Costs of the dashboard, and the time of its stop.

`python -m tests.benchmarks.dashboard stop|stale|drawn|viewers|memory`

- stop: from the space bar in chromium to 0 V at the emulated terminals, N times, and by stages.
- stale: from the death of the daemon to a page that says so, N times.
- drawn: time from a sample to its frame, frames a second, and processor time of the server. There
  are one page and ten viewers, at 100 Hz and at 1 kHz, for ROUND_S each.
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
from playwright.sync_api import sync_playwright

from tests.integration.driving import bring_to_rest
from tests.integration.processes import Bench, wait_for
from tests.integration.watching import Client, watched

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
    """Measure the way of a stop, from the request to chromium on."""
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
    """Measure the time until a page reports that its daemon is dead."""
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


_NOTES_DRAWN = """
async () => {
  const { LivePlots } = await import("./live_plots.js");
  const draw = LivePlots.prototype.draw;
  window.drawn = [];
  LivePlots.prototype.draw = function () {
    draw.call(this);
    const t = this.rows.newest;
    // The next frame begins after this one is on the screen.
    requestAnimationFrame((now) => window.drawn.push([t, performance.timeOrigin + now]));
  };
}
"""


def drawn() -> None:
    """Measure from sample to frame, and what the server costs; a stream of rows has samples."""
    for ts in (0.01, 0.001):
        with _rig() as bench, _dashboard(bench) as (url, pid):
            client = Client(url)
            with bench.rig() as rig:
                rig.arm("a benchmark", Ts=ts)
                rig.disarm()
            with _page(client) as page:
                page.evaluate(_NOTES_DRAWN)
                page.wait_for_timeout(2_000)
                with _share(pid) as share:
                    page.evaluate("window.drawn.length = 0")
                    page.wait_for_timeout(ROUND_S * 1e3)
                    frames = page.evaluate("window.drawn")
            _tell_drawn(ts, frames, share[0])
            with _watching(url), _share(pid) as share:
                time.sleep(ROUND_S)
            print(f"Ts {ts} s, ten viewers: server {share[0]:.1f} % of a processor", flush=True)


def _tell_drawn(ts: float, frames: list[list[float]], share: float) -> None:
    clock_s = (time.time_ns() - time.monotonic_ns()) / 1e9
    fresh = [frames[0]] + [b for a, b in itertools.pairwise(frames) if b[0] > a[0]]
    shown = [(t + clock_s, at_ms / 1e3) for t, at_ms in fresh]
    newest = [(at - t) * 1e3 for t, at in shown]
    # The oldest sample that a frame adds was due just after the newest of the frame before.
    oldest = [(b[1] - a[0] - ts) * 1e3 for a, b in itertools.pairwise(shown)]
    told(f"Ts {ts} s, newest sample to frame", newest, "ms")
    told(f"Ts {ts} s, oldest sample to frame", oldest, "ms")
    seconds = shown[-1][1] - shown[0][1]
    rate = (len(shown) - 1) / seconds
    print(f"Ts {ts} s, one page: {rate:.1f} frames/s with new samples, server {share:.1f} %")


@contextmanager
def _share(pid: int) -> Iterator[list[float]]:
    """Give a list that receives the processor time of a process, in % of one processor."""
    share: list[float] = []
    began_s, used_s = time.monotonic(), _used_s(pid)
    yield share
    share.append(100 * (_used_s(pid) - used_s) / (time.monotonic() - began_s))


def _used_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


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
        [sys.executable, "-m", "tests.benchmarks.dashboard", "watch", url],
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
def _dashboard(bench: Bench) -> Iterator[tuple[str, int]]:
    """Give the address and the process id of a dashboard."""
    with subprocess.Popen(
        [sys.executable, "-m", "armrig", "dashboard", "--json"],
        env={**os.environ, "XDG_RUNTIME_DIR": str(bench.folder)},
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout
        try:
            yield str(json.loads(process.stdout.readline())["url"]), process.pid
        finally:
            process.kill()


def viewers() -> None:
    """Compare rounds with and without viewers of a dashboard."""
    with _rig() as bench, _dashboard(bench) as (url, _):
        client = Client(url)
        wait_for(lambda: not client.first("live")["is_stale"])
        for _ in range(ROUNDS):
            alone = _round(bench)
            with _watching(url):
                watched_by_ten = _round(bench)
                left = client.first("timing")["viewers"] - 1  # without this viewer
            print(f"p99 of lateness, to subscriber [µs]: alone {alone}, ten {watched_by_ten}")
            print(f"of {VIEWERS} viewers {left} are left: who does not read is dropped", flush=True)


def memory() -> None:
    """Print heap and resident memory once a minute."""
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
        {"stop": stop, "stale": stale, "drawn": drawn, "viewers": viewers, "memory": memory}[
            sys.argv[1]
        ]()
