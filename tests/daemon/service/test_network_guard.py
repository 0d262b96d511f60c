"""A network with too many open files is shut for a while; the Unix socket goes on."""

from __future__ import annotations

from armrig_core.process.open_files import MAX_FILES, MAX_IDLE_FILES, SHUT_S, NetworkGuard


class Network:
    """A network that is shut and opened, and how many files are open."""

    def __init__(self) -> None:
        self.files = 25
        self.fault = ""
        self.done: list[str] = []

    def guard(self) -> NetworkGuard:
        """Return what guards it."""
        return NetworkGuard(lambda: self.files, lambda: self.done.append("shut"), self._open)

    def _open(self) -> str:
        self.done.append("open")
        return self.fault


def test_too_many_connections_are_ended_and_the_network_opened_again() -> None:
    network = Network()
    guard = network.guard()
    network.files = MAX_IDLE_FILES
    assert guard.look(0.0, is_busy=False) is None
    network.files = MAX_IDLE_FILES + 1

    shut = guard.look(0.0, is_busy=False)
    network.files = 25
    between = [guard.look(s, is_busy=False) for s in (1.0, SHUT_S - 0.1)]
    opened = guard.look(SHUT_S, is_busy=False)

    assert shut is not None
    assert shut[0] == "error"
    assert f"{MAX_IDLE_FILES + 1} files are open" in shut[1]
    assert between == [None, None]
    assert opened == ("info", "[access] the network is open again")
    assert network.done == ["shut", "open"]
    assert guard.look(SHUT_S + 1, is_busy=False) is None


def test_the_network_is_shut_in_a_run_only_if_files_run_out() -> None:
    network = Network()
    guard = network.guard()
    network.files = MAX_FILES
    assert guard.look(0.0, is_busy=True) is None

    network.files = MAX_FILES + 1
    assert guard.look(1.0, is_busy=True) is not None
    assert network.done == ["shut"]


def test_a_network_that_cannot_be_opened_again_is_tried_later() -> None:
    network = Network()
    guard = network.guard()
    network.files, network.fault = MAX_IDLE_FILES + 1, "another program listens there"
    guard.look(0.0, is_busy=False)

    assert guard.look(SHUT_S, is_busy=False) == ("error", "another program listens there")
    assert guard.look(SHUT_S + 1, is_busy=False) is None
    network.fault = ""
    assert guard.look(2 * SHUT_S, is_busy=False) == ("info", "[access] the network is open again")
