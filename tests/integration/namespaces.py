"""Machines on one: network namespaces, each with a line to the switch of the first."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import NamedTuple

ADDRESSES = {"rig": "10.77.0.1", "stranger": "10.77.0.2", "router": "10.77.0.3"}


class Namespaces(NamedTuple):
    """Machines by their names; the first is in the middle."""

    hosts: tuple[str, ...]

    def namespace(self, host: str) -> str:
        """Return the name of a machine's namespace."""
        return f"armrig-{os.getpid()}-{host}"

    def command(self, host: str, *arguments: str) -> list[str]:
        """Return a command that runs on a machine."""
        return ["ip", "netns", "exec", self.namespace(host), *arguments]


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
def connected(hosts: Sequence[str] = ("rig", "stranger")) -> Iterator[Namespaces]:
    """Give machines that reach only each other."""
    made = Namespaces(tuple(hosts))
    middle, *others = made.hosts
    try:
        for host in made.hosts:
            run("ip", "netns", "add", made.namespace(host))
            run(*made.command(host, "ip", "link", "set", "lo", "up"))
        run(*made.command(middle, "ip", "link", "add", "switch", "type", "bridge"))
        _up(made, middle, "switch")
        for host in others:
            run(
                *made.command(middle, "ip", "link", "add", host, "type", "veth"),
                *("peer", "name", "line", "netns", made.namespace(host)),
            )
            run(*made.command(middle, "ip", "link", "set", host, "master", "switch", "up"))
            _up(made, host, "line")
        yield made
    finally:
        for host in made.hosts:
            with suppress(subprocess.CalledProcessError):
                run("ip", "netns", "delete", made.namespace(host))


def _up(made: Namespaces, host: str, device: str) -> None:
    run(*made.command(host, "ip", "address", "add", f"{ADDRESSES[host]}/24", "dev", device))
    run(*made.command(host, "ip", "link", "set", device, "up"))


def run(*command: str) -> None:
    """Run a command of iproute2."""
    subprocess.run(command, check=True, capture_output=True, timeout=30)
