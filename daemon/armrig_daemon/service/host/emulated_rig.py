"""An emulated rig in a separate process, for a daemon without a real rig."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
from armrig_core.errors import OperationError
from armrig_core.process.signal_pipe import block_signals
from armrig_core.rig.emulated import SOCKET_PREFIX

from armrig_daemon.config import Config

_START_S = 30.0  # on a busy machine a program takes seconds to load


@contextmanager
def emulator_process(
    config: Config, directory: Path, stderr_fd: int | None = None
) -> Iterator[tuple[Config, int]]:
    """Start an emulator on a socket; yield the configuration for its port, and a descriptor.

    The emulator writes lines that can be read from the descriptor. Each line is a time, in ns, for
    which the device's clock stood still.

    `config` is a configuration with the table [emulator]. The emulator's socket is in `directory`.
    `stderr_fd` is its standard error, by default that of this process; it is closed here.

    Raises OperationError if the emulator ended, or took too long to start.
    """
    path = directory / f"{config.rig.id}-{os.getpid()}.line"
    port = f"{SOCKET_PREFIX}{path}"
    settings = msgspec.structs.replace(config.emulator, baud=config.device.baud)
    program = [sys.executable, "-m", "armrig_daemon", "emulate", "--port", port]
    program += ["--settings", msgspec.json.encode(settings).decode()]
    if config.rig.file:
        program += ["--rig-file", config.rig.file]
    program += ["--parent", str(os.getpid())]  # if this process ends, the emulator also ends
    stalls_out, stalls_in = os.pipe()
    os.set_blocking(stalls_in, False)
    try:
        with block_signals():
            child = subprocess.Popen(
                [*program, "--stalls-fd", str(stalls_in)], pass_fds=(stalls_in,), stderr=stderr_fd
            )
    finally:
        os.close(stalls_in)
        if stderr_fd is not None:
            os.close(stderr_fd)
    try:
        until = time.monotonic() + _START_S
        while not path.exists():
            if child.poll() is not None or time.monotonic() > until:
                raise OperationError(f"the emulator did not start at {path}")
            time.sleep(0.01)
        device = msgspec.structs.replace(config.device, port=port)
        yield msgspec.structs.replace(config, device=device), stalls_out
    finally:
        child.terminate()
        child.wait()
        os.close(stalls_out)
