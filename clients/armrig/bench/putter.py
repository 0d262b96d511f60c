"""A program: put samples that carry the time of their putting, with the service's zenoh settings.

The limit of what any publisher in Python can do: nothing is read, decoded, worked out or recorded.
"""

from __future__ import annotations

import json
import sys
import time

import zenoh
from armrig_core.telemetry import Sample, encode_sample
from armrig_core.topics import stream_key

from armrig.bench.kernel import end_with_parent


def session_config(endpoint: str) -> zenoh.Config:
    """Return the service's settings: listening at one Unix socket, found by nobody."""
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


def main() -> None:
    """Listen at the endpoint; then for each line `period_ns count` put so many."""
    end_with_parent()
    endpoint, rig = sys.argv[1:]
    with zenoh.open(session_config(endpoint)) as session:
        publisher = session.declare_publisher(
            stream_key(rig, "sample"), congestion_control=zenoh.CongestionControl.DROP
        )
        print("ready", flush=True)
        for line in sys.stdin:
            period_ns, count = map(int, line.split())
            due = time.monotonic_ns()
            for k in range(count):
                due += period_ns
                time.sleep(max(0, due - time.monotonic_ns()) / 1e9)
                now = time.monotonic_ns()
                publisher.put(encode_sample(Sample(k, due, now, 0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0)))
            print("done", flush=True)


if __name__ == "__main__":
    main()
