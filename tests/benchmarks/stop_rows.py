"""Events while the motor is driven: the rows of the table of stops in docs/safety.md."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from typing import NamedTuple

from tests.benchmarks.stand import Stand


class Row(NamedTuple):
    """Something that happens, and who is to stop the motor how soon."""

    what: str
    who: str
    bound: str
    act: Callable[[Stand], object]
    mode: str = "scheduled"
    """Mode of the run, a run with a dead-man, or a voltage held by hand."""
    has_line: bool = False
    """A line that can fail connects daemon and device."""
    ends_service: bool = False
    """The event ends the service; the time until its end is measured, too."""
    leaves_file: bool = False
    """The event leaves a recording, whose newest sample has an age."""
    most: int = 1_000_000
    """Most repetitions, for an event that takes long."""


_WATCHDOG = "the device's watchdog"
_110 = "110 ms"


def _signal(number: signal.Signals) -> Callable[[Stand], object]:
    return lambda stand: stand.daemon.kill(number)


def _line(what: str) -> Callable[[Stand], object]:
    return lambda stand: stand.line(what)


ROWS: dict[str, Row] = {
    "armrig stop": Row("`armrig stop`", "the core, at once", "Ts", lambda s: s.rig.stop()),
    "SIGTERM": Row(
        "SIGTERM to the service",
        "the core, at once",
        "Ts",
        _signal(signal.SIGTERM),
        ends_service=True,
    ),
    "SIGINT": Row(
        "SIGINT to the service",
        "the core, at once",
        "Ts",
        _signal(signal.SIGINT),
        ends_service=True,
    ),
    "SIGTERM, exchange": Row(
        "SIGTERM in exchange mode",
        "the core, at once",
        "Ts",
        _signal(signal.SIGTERM),
        "exchange",
        ends_service=True,
    ),
    "kill service": Row(
        "`kill -9` of the service",
        "the loop: the kernel signals it, and its pipes end",
        "the loop's tick, 10 ms",
        _signal(signal.SIGKILL),
        leaves_file=True,
    ),
    "kill loop": Row("`kill -9` of the loop, scheduled", _WATCHDOG, _110, Stand.kill_loop),
    "kill loop, exchange": Row(
        "`kill -9` of the loop, exchange", _WATCHDOG, _110, Stand.kill_loop, "exchange"
    ),
    "kill both": Row("`kill -9` of both", _WATCHDOG, _110, Stand.kill_both, leaves_file=True),
    "freeze loop": Row("SIGSTOP of the loop, scheduled", _WATCHDOG, _110, Stand.freeze_loop),
    "freeze loop, exchange": Row(
        "SIGSTOP of the loop, exchange", _WATCHDOG, _110, Stand.freeze_loop, "exchange"
    ),
    "freeze service": Row(
        "SIGSTOP of the service",
        "the loop, which hears nothing of it",
        "3 s + Ts",
        _signal(signal.SIGSTOP),
        most=5,
    ),
    "kill who holds by hand": Row(
        "`kill -9` of the client that holds a voltage by hand",
        "the core: the lease (100 ms)",
        "210 ms",
        lambda s: os.kill(s.client.pid, signal.SIGKILL),
        "hand",
    ),
    "freeze who holds by hand": Row(
        "SIGSTOP of the client that holds a voltage by hand",
        "the core: the lease",
        "210 ms",
        Stand.freeze_client,
        "hand",
    ),
    "kill client of dead-man": Row(
        "`kill -9` of the client of a run with a dead-man",
        "the service, by a stop in good order",
        "dead-man (1 s) + Ts",
        lambda s: os.kill(s.client.pid, signal.SIGKILL),
        "dead-man",
    ),
    "freeze client of dead-man": Row(
        "SIGSTOP of that client",
        "the same",
        "dead-man (1 s) + Ts",
        Stand.freeze_client,
        "dead-man",
    ),
    "disk full": Row(
        "disk full",
        "the service: its writer flushes at 10 Hz",
        "none: the input is still the requested input",
        Stand.fill_disk,
    ),
    "recordings moved": Row(
        "recordings folder moved",
        "the service: its writer looks for its file at 10 Hz",
        "none: as for a full disk",
        Stand.move_recordings,
    ),
    "recordings removed": Row(
        "recordings folder removed", "the same", "the same", Stand.remove_recordings
    ),
    "unplug": Row(
        "cable to the device pulled, scheduled", _WATCHDOG, _110, _line("unplug"), has_line=True
    ),
    "unplug, exchange": Row(
        "cable to the device pulled, exchange",
        _WATCHDOG,
        _110,
        _line("unplug"),
        "exchange",
        has_line=True,
    ),
    "device does not read": Row(
        "device does not read (exchange)",
        _WATCHDOG,
        _110,
        _line("stop_reading"),
        "exchange",
        has_line=True,
    ),
    "device is not heard": Row(
        "device is not heard (exchange)",
        "the core: round trip older than 50 ms",
        _110,
        _line("stop_answering"),
        "exchange",
        has_line=True,
    ),
    "device reset": Row(
        "device reset by DTR", "the device, at once", "1 ms", _line("reset"), has_line=True
    ),
}
