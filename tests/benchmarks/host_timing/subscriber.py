"""A program: note k, the host's time in each sample, and the time of its callback."""

from __future__ import annotations

import sys
import time
from array import array

import zenoh
from armrig.rig.session import open_session
from armrig_core.telemetry import decode_sample
from armrig_core.topics import stream_key

from tests.benchmarks.host_timing.kernel import end_with_parent


def main() -> None:
    """Listen until standard input ends, then write all received times as int64 triples."""
    end_with_parent()
    endpoint, rig = sys.argv[1:]
    heard = array("q")

    def receive(message: zenoh.Sample) -> None:
        now = time.monotonic_ns()
        sample = decode_sample(message.payload.to_bytes())
        if sample is not None:
            heard.extend((sample.k, sample.t_host_ns, now))

    with open_session(endpoint, rig=rig) as session:
        subscriber = session.declare_subscriber(stream_key(rig, "sample"), receive)
        print("ready", flush=True)
        sys.stdin.read()
        subscriber.undeclare()
    sys.stdout.buffer.write(heard.tobytes())


if __name__ == "__main__":
    main()
