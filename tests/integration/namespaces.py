"""Two machines on one: network namespaces with a line between them, the rig's and a stranger's."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Literal, NamedTuple

Side = Literal["rig", "stranger"]
ADDRESSES: dict[Side, str] = {"rig": "10.77.0.1", "stranger": "10.77.0.2"}


class Namespaces(NamedTuple):
    """Names of the two."""

    rig: str
    stranger: str

    def command(self, side: Side, *arguments: str) -> list[str]:
        """Return a command that runs on one side."""
        return ["ip", "netns", "exec", getattr(self, side), *arguments]


def missing() -> str:
    """Return what keeps us from making any, or nothing."""
    if os.getuid() != 0:
        return "network namespaces need root"
    if not shutil.which("ip") or not shutil.which("ss"):
        return "network namespaces need iproute2"
    trial = f"armrig-{os.getpid()}-trial"
    made = subprocess.run(["ip", "netns", "add", trial], capture_output=True, check=False)
    if made.returncode != 0:
        return "no network namespace can be made here: " + made.stderr.decode().strip()
    run("ip", "netns", "delete", trial)
    return ""


@contextmanager
def connected() -> Iterator[Namespaces]:
    """Give two namespaces, connected with each other only."""
    own = os.getpid()
    both = Namespaces(f"armrig-{own}-rig", f"armrig-{own}-stranger")
    ends: dict[Side, str] = {"rig": f"ar{own}", "stranger": f"as{own}"}  # 15 characters at most
    try:
        for name in both:
            run("ip", "netns", "add", name)
        run("ip", "link", "add", ends["rig"], "type", "veth", "peer", "name", ends["stranger"])
        for side, end in ends.items():
            run("ip", "link", "set", end, "netns", getattr(both, side))
            run(*both.command(side, "ip", "address", "add", f"{ADDRESSES[side]}/24", "dev", end))
            run(*both.command(side, "ip", "link", "set", end, "up"))
            run(*both.command(side, "ip", "link", "set", "lo", "up"))
        yield both
    finally:
        for name in both:
            with suppress(subprocess.CalledProcessError):
                run("ip", "netns", "delete", name)


def run(*command: str) -> None:
    """Run a command of iproute2."""
    subprocess.run(command, check=True, capture_output=True, timeout=30)
