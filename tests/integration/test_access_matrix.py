"""Permissions over a network: every client tries every operation of zenoh on every key.

Each cell is tried 20 times at a daemon and 4 times at a router, from a network namespace of its
own. As the control the same attempts succeed without the guard, so that an empty cell is evidence.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from subprocess import Popen
from typing import Any, NamedTuple

import pytest

from tests.integration import namespaces
from tests.integration.fleet_lab import FleetLab
from tests.integration.laboratory import by_certificate, certificates
from tests.integration.namespaces import ADDRESSES, Namespaces
from tests.integration.processes import Bench, wait_for
from tests.integration.remote_rig import (
    GUARDED,
    HERE,
    PORT,
    UNGUARDED,
    WITHIN_S,
    said,
    started,
    stranger,
    watching,
)
from tests.integration.stranger import (
    ALIVE,
    FORGED,
    STREAM_KEYS,
    TOLD_KEYS,
    command_keys,
    every_key,
)

pytestmark = pytest.mark.machine
ROUTER = {True: ("-m", "armrig"), False: (str(HERE / "unguarded.py"),)}
"""Programs of the router, with and without its guard."""
TIMES = {"daemon": 20, "router": 4}
WHO = {
    "daemon": ("nobody", "forged", "expired", "wrong", "eve", "bob", "alice"),
    "router": ("nobody", "forged", "wrong", "rig-2", "bob", "alice"),
}
NOT_LET_IN = ("nobody", "forged", "expired")
PERMITTED = {"bob": ["rig/1/cmd/status/bob"], "alice": command_keys("alice")}
EVERYBODY = [(way, who) for way in WHO for who in WHO[way]]
STRANGERS = [(way, who) for way, who in EVERYBODY if who not in PERMITTED]


class Tried(NamedTuple):
    """Results of all attempts."""

    by: dict[str, dict[str, Any]]
    watcher: dict[str, dict[str, int]]
    log: str


Try = Callable[[str, bool], Tried]


@pytest.fixture(scope="module")
def tried(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Try]:
    """Give a function that returns what everybody can do, with and without the guard."""
    if why := namespaces.missing():
        pytest.skip(why)
    with namespaces.connected(["rig", "router", "stranger"]) as net:
        yield cache(lambda way, guard: _tried(net, tmp_path_factory.mktemp(way), way, guard))


def _tried(net: Namespaces, folder: Path, way: str, guard: bool) -> Tried:
    bench = Bench(folder)
    with ExitStack() as stack:
        stack.callback(bench.end)
        if way == "daemon":
            made = certificates(folder)
            where = by_certificate(bench, made, f"tls/{ADDRESSES['rig']}:{PORT}")
        else:
            lab = FleetLab(folder, ADDRESSES["router"])
            made, where = lab.made, lab.endpoint
            bench.configure(more=lab.access("1"))
        bench.emulate()
        program = GUARDED if guard or way == "router" else UNGUARDED
        log = stack.enter_context(started(net, bench, *program))
        if way == "router":
            stack.enter_context(_routed(net, lab, log, guard))
        environ = stack.enter_context(pytest.MonkeyPatch.context())
        environ.setenv("STRANGER_TIMES", str(TIMES[way]))
        with watching(net, where, made) as watcher:
            attempts = {
                who: stranger(net, where, made, who, "" if who == "nobody" else f"{who}.pem")
                for who in WHO[way]
            }
            by = {who: said(attempt) for who, attempt in attempts.items()}
        return Tried(by, said(watcher), log.read_text())


@contextmanager
def _routed(net: Namespaces, lab: FleetLab, log: Path, guard: bool) -> Iterator[None]:
    """Have a router run, and the daemon found through it."""
    command = [sys.executable, *ROUTER[guard], *lab.router_command()]
    with Popen(net.command("router", *command)) as router:
        try:
            wait_for(lambda: "connected to the router" in log.read_text(), WITHIN_S)
            yield
        finally:
            router.kill()


def _worked(counts: dict[str, int]) -> dict[str, int]:
    return {key: n for key, n in counts.items() if n}


@pytest.mark.parametrize(("way", "who"), STRANGERS)
def test_a_client_without_permission_receives_and_changes_nothing(
    tried: Try, way: str, who: str
) -> None:
    found = tried(way, True).by[who]

    assert found["links"] == (0 if who in NOT_LET_IN else TIMES[way])
    for what in ("query", "liveliness", "subscribe", "tokens", "overhear"):
        assert _worked(found[what]) == {}, what


@pytest.mark.parametrize("way", WHO)
@pytest.mark.parametrize("who", PERMITTED)
def test_a_client_has_exactly_the_permissions_of_the_access_list(
    tried: Try, way: str, who: str
) -> None:
    found, times = tried(way, True).by[who], TIMES[way]
    heard, alive = _worked(found["subscribe"]), _worked(found["liveliness"])
    wild = {"rig/1/*", "rig/*/sample"} if way == "router" else {"rig/1/*"}

    assert found["links"] == times
    assert _worked(found["query"]) == dict.fromkeys((*TOLD_KEYS, *PERMITTED[who]), times)
    assert {"rig/1/sample", *wild} <= heard.keys() <= {*STREAM_KEYS, *wild}
    assert alive.keys() == {ALIVE, "rig/1/*"}
    assert _worked(found["overhear"]) == {}
    if way == "daemon":
        assert min(heard["rig/1/sample"], heard["rig/1/*"]) > times / 2
        assert {*alive.values()} == {times}
        # The stranger's own session delivers its token to each of its matching subscribers.
        assert who == "alice" or min(found["tokens"][key] for key in alive) > times / 2


@pytest.mark.parametrize("way", WHO)
def test_no_forged_message_reaches_a_listener(tried: Try, way: str) -> None:
    """No sample, no token, no reply."""
    watcher = tried(way, True).watcher

    assert watcher["heard"]["rig/1/sample"] > 100
    assert _worked(watcher["forged"]) == {}


@pytest.mark.parametrize("way", WHO)
def test_the_daemon_accepts_commands_only_from_an_operator(tried: Try, way: str) -> None:
    log = tried(way, True).log
    taken = [line.split(": by ")[1] for line in log.splitlines() if ": by " in line]

    assert taken
    assert {who for who in taken if not who.startswith("certificate alice")} == set()


@pytest.mark.parametrize(("way", "who"), EVERYBODY)
def test_any_client_has_every_permission_without_access_control(
    tried: Try, way: str, who: str
) -> None:
    """The control: the same attempts, and all of them succeed."""
    unguarded, times = tried(way, False), TIMES[way]
    found, forged = unguarded.by[who], _worked(unguarded.watcher["forged"])

    assert found["links"] == times
    assert set(command_keys(who)) | set(command_keys("alice")) <= {
        key for key, n in found["query"].items() if n == times or (way == "router" and n)
    }
    assert {"rig/1/sample", "rig/1/*", "rig/1/**", "**"} <= _worked(found["subscribe"]).keys()
    assert {ALIVE, "rig/1/*", "**"} <= _worked(found["liveliness"]).keys()
    assert forged[f"PUT {who}"] > times
    assert way == "router" or forged[f"DELETE {who}"] > times
    assert forged[f"TOKEN {FORGED}"] > 0


def test_replies_can_be_forged_without_access_control(tried: Try) -> None:
    """The control of the watcher."""
    assert any(_worked(found["overhear"]) for found in tried("daemon", False).by.values())


def test_the_matrix_covers_every_key_of_the_rig() -> None:
    keys = every_key("bob")

    assert len(keys) == len(set(keys))
    assert {*STREAM_KEYS, ALIVE, *TOLD_KEYS, *command_keys("bob")} <= set(keys)
