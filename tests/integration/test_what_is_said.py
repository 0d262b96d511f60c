"""Messages about a served rig, and about a command without effect."""

from __future__ import annotations

import os
import re
import select
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest

from tests.integration.processes import Bench, wait_for
from tests.sampling import sampled


def test_the_daemon_and_the_emulator_print_what_they_serve(bench: Bench) -> None:
    bench.configure(more="[limits]\nu_max_v = 4.5")
    emulator = bench.emulate()
    daemon = bench.serve()

    wait_for(lambda: emulator.said and "armrig status" in daemon.said)
    served, emulated = (
        [line for line in program.said.splitlines() if "not granted" not in line]
        for program in (daemon, emulator)
    )
    assert emulated == [
        f"armrigd: an emulated rig is at {bench.port}, 1000000 baud, 0 to 5 V; drive it with "
        f"`ARMRIG_DEVICE_BAUD=1000000 armrigd run --port {bench.port}`, end it with Ctrl-C"
    ]
    assert served == [
        f"armrigd: info: rig 1 at {bench.endpoint}",
        f"armrigd: info: port {bench.port} at 1000000 baud, 0 to 4.5 V; ask it with "
        "`armrig status`, end it with Ctrl-C",
    ]


@contextmanager
def _deaf(bench: Bench, noise: int) -> Iterator[None]:
    """Have a device at the bench's port without answers, with `noise` B/ms at random."""
    bench.use_terminal()
    master, slave = os.openpty()
    os.set_blocking(master, False)
    bench.port.symlink_to(os.ttyname(slave))
    ended = threading.Event()

    def speak() -> None:
        while not ended.wait(0.001):
            if select.select([master], [], [], 0)[0]:
                os.read(master, 4096)
            with suppress(BlockingIOError):  # nobody reads, as long as there is no daemon
                os.write(master, os.urandom(noise))

    speaking = threading.Thread(target=speak)
    speaking.start()
    try:
        yield
    finally:
        ended.set()
        speaking.join()
        os.close(slave)
        os.close(master)


@pytest.mark.parametrize(
    ("noise", "said"),
    sampled(
        [
            (
                0,
                r"\d+ requests at 1000000 baud had no answer; check that the device has power",
            ),
            (1, r"\d+ bytes came at 1000000 baud, but no frame; .* \[device\] baud"),
            (
                500,
                r"\d+ bytes came at 1000000 baud, but no frame; .* \[device\] baud",
            ),
        ],
        1,
    ),
)
def test_an_unanswering_device_is_reported_with_the_remedy(
    bench: Bench, noise: int, said: str
) -> None:
    with _deaf(bench, noise):
        daemon = bench.start("armrig_daemon", "run", "--config", str(bench.config))
        wait_for(lambda: re.search(said, daemon.said))
        status = bench.armrig("status")
        armed = bench.armrig("collect", "step")
        log = daemon.said
        assert daemon.end() == 0

    (row,) = [row for row in status.stdout.splitlines() if row.startswith("device")]
    assert row.split(None, 1)[1].startswith(f"{bench.port}: the device does not answer: ")
    assert re.search(said, row)
    assert (status.returncode, armed.returncode) == (0, 1)
    assert armed.stderr.startswith(f"armrig: {bench.port}: the device does not answer: ")
    assert armed.stderr.count("\n") == 1
    assert log.count("the device does not answer") == 1
    assert "Traceback" not in log
