"""Machines of a lab on one: network namespaces, each with a line to the switch of the first."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from subprocess import CalledProcessError

from tests.integration.namespaces import run

_NETWORK = "10.78.0"


class Star:
    """Machines by their names; the first is in the middle."""

    def __init__(self, hosts: Sequence[str]) -> None:
        self.hosts = tuple(hosts)

    def address(self, host: str) -> str:
        """Return the address of a machine."""
        return f"{_NETWORK}.{1 + self.hosts.index(host)}"

    def namespace(self, host: str) -> str:
        """Return the name of its namespace."""
        return f"armrig-{os.getpid()}-{host}"

    def command(self, host: str, *arguments: str) -> list[str]:
        """Return a command that runs on a machine."""
        return ["ip", "netns", "exec", self.namespace(host), *arguments]


@contextmanager
def star(hosts: Sequence[str]) -> Iterator[Star]:
    """Give machines that reach only each other."""
    made = Star(hosts)
    middle = made.hosts[0]
    try:
        for host in made.hosts:
            run("ip", "netns", "add", made.namespace(host))
            run(*made.command(host, "ip", "link", "set", "lo", "up"))
        run(*made.command(middle, "ip", "link", "add", "switch", "type", "bridge"))
        _up(made, middle, "switch")
        for number, host in enumerate(made.hosts[1:]):
            run(
                *made.command(middle, "ip", "link", "add", f"port{number}", "type", "veth"),
                *("peer", "name", "line", "netns", made.namespace(host)),
            )
            run(*made.command(middle, "ip", "link", "set", f"port{number}", "master", "switch"))
            run(*made.command(middle, "ip", "link", "set", f"port{number}", "up"))
            _up(made, host, "line")
        yield made
    finally:
        for host in made.hosts:
            with suppress(CalledProcessError):
                run("ip", "netns", "delete", made.namespace(host))


def _up(made: Star, host: str, device: str) -> None:
    run(*made.command(host, "ip", "address", "add", f"{made.address(host)}/24", "dev", device))
    run(*made.command(host, "ip", "link", "set", device, "up"))
