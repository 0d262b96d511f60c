"""The programs that the daemon is compared with; the first argument is the function to run."""

from __future__ import annotations

import ctypes
import gc
import json
import os
import pty
import sys
import time
import tty
from array import array

import zenoh
from armrig.lab.host import PRIORITY
from armrig.rig.session import open_session
from armrig_core.process.realtime import prepare
from armrig_core.process.waiting import TERMINAL_BYTES, Waiter, sleep_until
from armrig_core.telemetry.telemetry import Sample as Telemetry
from armrig_core.telemetry.telemetry import decode_sample, encode_sample
from armrig_core.telemetry.topics import stream_key
from armrig_daemon.service.listener import session_config
from armrig_protocol.frame import wire_length
from armrig_protocol.messages import Exchange, Sample

RIG = "1"
REQUEST_LENGTH, ANSWER_LENGTH = wire_length(Exchange), wire_length(Sample)
ECHO_PRIORITY = 20  # the emulator's
SPIN_NS = 120_000
"""Spin of the daemon's loop before each deadline, in ns."""
MARGIN_NS = 90_000
"""Time between the end of the loop's first wait and the spin, in ns."""
ANSWER_NS = 1_000_000_000
WARM_UP = 2
"""Ticks before those that count: the first call of each function takes longer."""
WINDOW_NS = 100_000_000
"""Duration of each count of processor time, in ns."""
_PR_SET_TIMERSLACK = 29  # <linux/prctl.h>


def be_punctual(priority: int, *, lock: bool = False) -> bool:
    """Request from the kernel what the daemon requests; return whether SCHED_FIFO was granted."""
    if lock:
        return prepare(priority, None)["fifo"] == priority
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    return True


def echo() -> None:
    """Answer each request on a pseudo-terminal with a fixed answer, as a device without a model."""
    master, slave = pty.openpty()
    tty.setraw(slave)  # kept open, or the master would see the end of it between two openings
    print(os.ttyname(slave), flush=True)
    be_punctual(ECHO_PRIORITY)
    answer, received = bytes(ANSWER_LENGTH), 0
    while True:
        received += len(os.read(master, 4096))
        while received >= REQUEST_LENGTH:
            received -= REQUEST_LENGTH
            os.write(master, answer)


def bare_loop(port: str, period: str, count: str) -> None:
    """Wake, write a request and read the answer as the daemon's loop does, and do nothing else.

    Print the lateness of each tick, and the processor time per tick over windows of `WINDOW_NS`.
    """
    # Without the daemon's priority, other programs would delay the loop and flatter the daemon.
    spin_ns = SPIN_NS if be_punctual(PRIORITY, lock=True) else 0
    period_ns, ticks = int(period), int(count)
    fd, waiter = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK), Waiter()
    waiter.watch_terminal(fd)
    late: list[int] = []
    cpu: list[float] = []
    due = time.monotonic_ns() + period_ns
    window = due, 0, 0
    for n in range(-WARM_UP, ticks + 1):
        waiter.wait_until(due - spin_ns - MARGIN_NS)
        now = sleep_until(due, spin_ns)
        if n > 0:
            late.append(now - due)
        # Missed deadlines are skipped, as cyclictest skips them.
        due += period_ns * (1 + max(0, now - due) // period_ns)
        _exchange(fd, waiter, now, due - spin_ns - MARGIN_NS)
        if n == 0:
            window = now, time.thread_time_ns(), 0
        elif n > 0 and (now - window[0] >= WINDOW_NS or n == ticks):
            used = time.thread_time_ns()
            cpu.append((used - window[1]) / (n - window[2]))
            window = now, used, n
    print(json.dumps([late, cpu]))


def _exchange(fd: int, waiter: Waiter, began_ns: int, until_ns: int) -> None:
    os.write(fd, bytes(REQUEST_LENGTH))
    received = 0
    while received < ANSWER_LENGTH:
        if waiter.wait_until(until_ns):
            received += len(os.read(fd, TERMINAL_BYTES))
        elif until_ns < began_ns + ANSWER_NS:
            until_ns = began_ns + ANSWER_NS
        else:
            raise SystemExit(f"no answer within {ANSWER_NS / 1e9:g} s")


def publish(endpoint: str, period_ns: str, count: str) -> None:
    """Put samples that carry the time of their putting, with the service's zenoh settings.

    The limit of any publisher in Python: nothing is read, decoded, computed or recorded.
    """
    with zenoh.open(session_config(endpoint)) as session:
        publisher = session.declare_publisher(
            stream_key(RIG, "sample"), congestion_control=zenoh.CongestionControl.DROP
        )
        print("ready", flush=True)
        sys.stdin.readline()
        due = time.monotonic_ns()
        for k in range(int(count)):
            due += int(period_ns)
            time.sleep(max(0, due - time.monotonic_ns()) / 1e9)
            now = time.monotonic_ns()
            publisher.put(encode_sample(Telemetry(k, due, now, 0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0)))
        print("done", flush=True)
        sys.stdin.read()


def subscribe(endpoint: str) -> None:
    """Receive until standard input ends, then write k, host time and callback time of each."""
    received = array("q")

    def receive(message: zenoh.Sample) -> None:
        now = time.monotonic_ns()
        sample = decode_sample(message.payload.to_bytes())
        if sample is not None:
            received.extend((sample.k, sample.t_host_ns, now))

    with open_session(endpoint, rig=RIG) as session:
        subscriber = session.declare_subscriber(stream_key(RIG, "sample"), receive)
        print("ready", flush=True)
        sys.stdin.read()
        subscriber.undeclare()
    sys.stdout.buffer.write(received.tobytes())


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
