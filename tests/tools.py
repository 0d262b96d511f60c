"""Programs that some tests need and a machine may lack, with the way to install each on Debian."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

_PACKAGES = {
    "avr-gcc": "gcc-avr avr-libc",
    "avrdude": "avrdude",
    "cc": "gcc libc6-dev",
    "chromium": "chromium",
    "lua5.4": "lua5.4",
    "make": "make",
    "nft": "nftables",
    "node": "nodejs",
    "octave-cli": "octave octave-control",
    "simavr": "libsimavr-dev",
    "strace": "strace",
    "systemd-analyze": "systemd",
    "udevadm": "udev",
}
_SIMAVR = Path("/usr/include/simavr/sim_avr.h")  # a library: there is no program to look for


def lacking(*tools: str) -> str:
    """Return the first tool that this machine lacks and how to install it; "" if it has all."""
    for tool in tools:
        found = _SIMAVR.exists() if tool == "simavr" else shutil.which(tool)
        if not found:
            return f"no {tool}: apt install {_PACKAGES[tool]}"
    return ""


def needs(*tools: str) -> pytest.MarkDecorator:
    """Return the mark that skips a test on a machine without these tools."""
    why = lacking(*tools)
    return pytest.mark.skipif(bool(why), reason=why)


def require(*tools: str) -> None:
    """Skip the running test on a machine without these tools."""
    why = lacking(*tools)
    if why:
        pytest.skip(why)
