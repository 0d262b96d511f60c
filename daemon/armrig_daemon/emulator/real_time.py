"""The emulator in real time: it connects a device to a pseudo-terminal or a socket.

Opening the port resets an Uno. A pseudo-terminal or a socket has no DTR, so the emulator resets the
device when a program opens the port. Closing the port resets nothing, as on an Uno; the device's
frames are then lost.
"""

from __future__ import annotations

import ctypes
import gc
import os
import signal
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from time import monotonic_ns
from typing import TextIO

from armrig_core.access.emulator_socket import socket_path
from armrig_core.errors import OperationError
from armrig_core.process.line_writer import print_error
from armrig_core.process.printable import plural
from armrig_core.process.signal_pipe import SignalPipe
from armrig_core.process.waiting import Waiter

from armrig_daemon.emulator.board import Change, Witness
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.harness import CYCLES_PER_US, Violated, Violation
from armrig_daemon.emulator.host_time import HostTime, StallReports
from armrig_daemon.emulator.line import READ_BYTES, EmulatedLine, Terminal
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.emulator.socket_line import SocketLine
from armrig_daemon.emulator.uart import wire_ns
from armrig_daemon.emulator.uno import AnyDevice

PRIORITY = 20  # lower than the loop's, so that the device does not delay the daemon
PR_SET_TIMERSLACK = 29  # <linux/prctl.h>
_libc = ctypes.CDLL(None)


SwitchOn = Callable[[EmulatorSettings, int, Witness], AnyDevice]
"""Function that creates a device, switched on at a time in ns."""


def emulate(
    port: Path,
    settings: EmulatorSettings,
    *,
    switch_on: SwitchOn = Device,
    trace: Path | None = None,
    started: str = "",
    held_up: Callable[[int], None] = lambda ns: None,
    say: Callable[[str], None] = print_error,
) -> int:
    """Run a rig at `port` until SIGTERM or SIGINT; return the exit code.

    If a simulated board's pins violate a rule, the exit code is 1. Each kind of violation is
    printed once.

    `port` is the path of the symbolic link to a pseudo-terminal, or `unix:PATH` for a socket. The
    link or the socket is created, and is removed at the end. `switch_on` creates the device, by
    default the emulated device. The message `started` is printed when the port exists.

    The file `trace` has a line `t_monotonic_ns,volts,state,cause` for each change of the terminal
    voltage. The first line is the state at the start.

    If the settings tolerate stalls, `held_up` is called after a stall of this process. Its argument
    is the time for which the device's clock stood still, in ns. `say` prints a line. Neither
    function may wait, because the emulated device would stand still.

    Raises OperationError if `port` or `trace` cannot be created.
    """
    with ExitStack() as stack:
        wake = _end_signal_fd(stack)
        line = _line(port, stack)
        out: TextIO | None = None
        if trace is not None:
            with _naming(trace):
                out = stack.enter_context(trace.open("w", encoding="utf-8", buffering=1))

        def witness(change: Change) -> None:
            if out is not None:
                t_ns = time.monotonic_ns(change.t_ns)
                fields = (t_ns, repr(change.volts), change.state.name, change.cause.name)
                out.write(",".join(map(str, fields)) + "\n")

        is_punctual = _is_made_punctual(stack)
        now_ns = monotonic_ns()
        time = HostTime(now_ns, tolerates_stalls=settings.tolerates_stalls)
        device = switch_on(settings, now_ns, witness)
        witness(Change(now_ns, device.board.volts, device.state, device.cause))
        # Last, so that the device is running when a program finds the link.
        with _naming(port):
            line.offer(port, stack)
        if started:
            say(started)
        if not is_punctual:
            text = "not granted: SCHED_FIFO; the emulated rig may reply late"
            say(f"armrigd: warning: {text}")
        _run(line, device, time, settings, wake, held_up, partial(_say_violation, say, port))
        lost = line.backlog
        if lost.dropped_frames:
            text = (
                f"{plural(lost.dropped_frames, 'frame')} "
                f"({plural(lost.dropped_bytes, 'byte')}) dropped"
            )
            say(f"{port}: {text}, because they were not read in time")
            # The firmware itself counts the bytes that the host sends too fast.
        wrong = {violated.what for violated in device.violations} - {Violation.RX_OVERRUN}
    return 1 if wrong else 0


def _run(
    line: EmulatedLine,
    device: AnyDevice,
    time: HostTime,
    settings: EmulatorSettings,
    wake: int,
    held_up: Callable[[int], None],
    violated: Callable[[Violated], None],
) -> None:
    """Pass bytes between line and device until `wake` is readable."""
    full_ns = wire_ns(READ_BYTES, settings.baud) if settings.model_baud else 0
    replies: deque[tuple[int, bytes]] = deque()
    due_ns = looked = 0
    stalls = StallReports(held_up)
    seen: set[Violation] = set()
    with closing(Waiter()) as waiter:
        waiter.watch(wake)
        line.watch(waiter)
        while True:
            now_ns = time.emulation_ns(monotonic_ns(), due_ns)
            stalls.update(time.held_up_ns, now_ns)
            replies.extend(device.advance(now_ns))
            for violation in device.violations[looked:]:
                looked += 1
                if violation.what not in seen:
                    violated(violation)
                seen.add(violation.what)
            while replies and replies[0][0] <= now_ns:
                line.write(replies.popleft()[1])
            due_ns = device.visible_ns()
            if replies:
                due_ns = min(due_ns, replies[0][0])
            if line.connected and line.has_input:
                # Read only as fast as the wire transmits, so that the kernel slows the host down.
                due_ns = min(due_ns, now_ns + device.rx_backlog_ns(now_ns) - full_ns)
            line.watch_room()
            due_ns = time.look_ns(due_ns)
            waits = due_ns > now_ns
            ready = dict(waiter.wait_until(time.monotonic_ns(due_ns)) if waits else waiter.ready())
            if wake in ready:
                return
            if line.opened_fd in ready and line.was_opened():
                line.flush()
                device.reset(time.emulation_ns(monotonic_ns(), due_ns))
                replies.clear()
            elif line.fd in ready:
                line.note_ready(ready[line.fd])
            now_ns = time.emulation_ns(monotonic_ns(), due_ns)
            if line.connected and line.has_input and device.rx_backlog_ns(now_ns) <= full_ns:
                data = line.read()
                if data:
                    device.receive(time.emulation_ns(monotonic_ns(), due_ns), data)


def _say_violation(say: Callable[[str], None], port: Path, violated: Violated) -> None:
    ms = violated.cycle / CYCLES_PER_US / 1000
    say(f"{port}: {violated.what.sentence}, {ms:.2f} ms after power-on")


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Convert the system's error about a file into an OperationError that names the file."""
    try:
        yield
    except OSError as err:
        raise OperationError(f"{path}: {err.strerror}") from err


def _line(port: Path, stack: ExitStack) -> EmulatedLine:
    """Return a socket for a port `unix:PATH`, and a pseudo-terminal for any other port."""
    try:
        path = socket_path(str(port))
    except ValueError as err:
        raise OperationError(str(err)) from err
    return Terminal(stack) if path is None else SocketLine(path, stack)


def _end_signal_fd(stack: ExitStack) -> int:
    """Return a descriptor that becomes readable at SIGTERM or SIGINT, until `stack` ends."""
    signals = SignalPipe([signal.SIGTERM, signal.SIGINT])

    def close(failed: type[BaseException] | None, *_: object) -> None:
        signals.close(ignores=failed is None)

    stack.push(close)
    return signals.fd


def _is_made_punctual(stack: ExitStack) -> bool:
    """Request real-time scheduling until `stack` ends, and return whether it was granted."""
    _libc.prctl(PR_SET_TIMERSLACK, ctypes.c_ulong(1), 0, 0, 0)
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        stack.callback(os.sched_setscheduler, 0, *before)
        is_granted = True
    except PermissionError:
        is_granted = False
    gc.freeze()
    gc.disable()
    stack.callback(gc.enable)
    return is_granted
