"""A program: put samples that carry the time of their putting, with the service's zenoh settings.

The limit of what any publisher in Python can do: nothing is read, decoded, worked out or recorded.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator

import zenoh
from armrig_core.telemetry import SAMPLE_LENGTH, Sample, encode_sample
from armrig_core.topics import stream_key

from tests.benchmarks.host_timing.kernel import PARENT, end_with_parent


def session_config(endpoint: str) -> zenoh.Config:
    """Return the service's settings: listening at one Unix socket, without discovery."""
    return zenoh.Config.from_json5(
        json.dumps(
            {
                "mode": "peer",
                "listen": {"endpoints": [endpoint]},
                "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
                "adminspace": {"enabled": False},
                "transport": {
                    "shared_memory": {"enabled": False},
                    "link": {
                        "tx": {"queue": {"congestion_control": {"drop": {"wait_before_drop": 0}}}}
                    },
                },
            }
        )
    )


def write_samples(where: int) -> None:
    """Read lines `period_ns count`; for each write so many samples, with their times.

    A sample is written whole or not at all: a pipe takes up to 4096 bytes as one.
    """
    for line in sys.stdin:
        period_ns, count = map(int, line.split())
        for sample in timed(period_ns, count):
            os.write(where, sample)
        print("done", flush=True)


def timed(period_ns: int, count: int) -> Iterator[bytes]:
    """Give a sample each period, encoded at the time that it carries."""
    due = time.monotonic_ns()
    for k in range(count):
        due += period_ns
        time.sleep(max(0, due - time.monotonic_ns()) / 1e9)
        now = time.monotonic_ns()
        yield encode_sample(Sample(k, due, now, 0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0))


def main() -> None:
    """Listen at the endpoint; then for each line `period_ns count` put `count` samples.

    With `piped` as the third argument another process makes the samples, and this process reads
    them from a pipe. That is the least cost of a loop in a process of its own.
    """
    end_with_parent()
    endpoint, rig, *way = sys.argv[1:]
    source = _forked() if way == ["piped"] else None
    with zenoh.open(session_config(endpoint)) as session:
        publisher = session.declare_publisher(
            stream_key(rig, "sample"), congestion_control=zenoh.CongestionControl.DROP
        )
        print("ready", flush=True)
        if source is not None:
            while sample := os.read(source, 4096):
                for at in range(0, len(sample), SAMPLE_LENGTH):
                    publisher.put(sample[at : at + SAMPLE_LENGTH])
            return
        for line in sys.stdin:
            period_ns, count = map(int, line.split())
            for sample in timed(period_ns, count):
                publisher.put(sample)
            print("done", flush=True)


def _forked() -> int:
    """Return where another process, started before any session is open, writes its samples."""
    source, sink = os.pipe()
    here = os.getpid()
    if os.fork() == 0:
        os.environ[PARENT] = str(here)
        end_with_parent()
        os.close(source)
        write_samples(sink)
        os._exit(0)
    os.close(sink)
    return source


if __name__ == "__main__":
    main()
