"""A lab's router, rigs and clients on machines of their own, with real daemons.

The permissions through the router are tried as at a daemon (test_access_matrix.py), and also by
another rig's certificate. The control is the same router without its access control.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.integration import namespaces
from tests.integration.fleet_lab import RIGS, WITHIN_S, FleetLab
from tests.integration.fork_server import ForkServer
from tests.integration.processes import Bench, wait_for
from tests.integration.remote_rig import HERE, said, stranger, watching
from tests.integration.star import Star, star
from tests.integration.stranger import ALIVE, FORGED, STREAM_KEYS, TOLD_KEYS, command_keys

pytestmark = pytest.mark.machine
FEW = 4
WHO = {
    "nobody": "",
    "forged": "forged.pem",
    "wrong": "wrong.pem",
    "rig-2": "rig-2.pem",
    "bob": "bob.pem",
    "alice": "alice.pem",
}
GUARDED = ("-m", "armrig")
UNGUARDED = (str(HERE / "open_router.py"),)


class Lab(NamedTuple):
    """A lab whose daemons run, and whose router is the test's."""

    net: Star
    files: FleetLab
    benches: dict[str, Bench]

    def logs(self) -> str:
        """Return the daemons' logs."""
        return "".join((bench.folder / "log").read_text() for bench in self.benches.values())


class Tried(NamedTuple):
    """Results of all attempts."""

    by: dict[str, dict[str, Any]]
    watcher: dict[str, dict[str, int]]
    log: str


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory, forks: ForkServer) -> Iterator[Lab]:
    """Give three rigs on their machines; their daemons wait for a router."""
    if why := namespaces.missing():
        pytest.skip(why)
    folder = tmp_path_factory.mktemp("lab")
    with star(["router", *(f"rig-{rig}" for rig in RIGS), "stranger"]) as net:
        files = FleetLab(folder, net.address("router"))
        benches = {rig: Bench(_made(folder / f"bench-{rig}"), forks) for rig in RIGS}
        daemons: list[subprocess.Popen[bytes]] = []
        try:
            for rig, bench in benches.items():
                bench.configure(watchdog_ms=250, more=files.access(rig))
                bench.emulate()
                daemons.append(_served(net, bench, rig))
            yield Lab(net, files, benches)
            for daemon in daemons:
                daemon.terminate()
            assert [daemon.wait(WITHIN_S) for daemon in daemons] == [0, 0, 0]
        finally:
            for daemon in daemons:
                daemon.kill()
                daemon.wait()
            for bench in benches.values():
                bench.end()


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _served(net: Star, bench: Bench, rig: str) -> subprocess.Popen[bytes]:
    command = (sys.executable, "-m", "armrig_daemon", "run", "--config", str(bench.config))
    with (bench.folder / "log").open("wb") as log:
        return subprocess.Popen(
            ["env", f"XDG_RUNTIME_DIR={bench.folder}", *net.command(f"rig-{rig}", *command)],
            stderr=log,
        )


@contextmanager
def routed(lab: Lab, *program: str) -> Iterator[subprocess.Popen[bytes]]:
    """Have a router run on its machine, and all rigs found through it."""
    command = [sys.executable, *program, *lab.files.router_command()]
    router = subprocess.Popen(lab.net.command("router", *command))
    try:
        wait_for(lambda: _phases(lab) == dict.fromkeys(RIGS, "safe"), WITHIN_S)
        yield router
    finally:
        router.kill()
        router.wait()


def _armrig(lab: Lab, *arguments: str) -> subprocess.Popen[str]:
    """Start a command of bob's on the people's machine."""
    return subprocess.Popen(
        lab.net.command("stranger", sys.executable, "-m", "armrig", *arguments),
        env={**os.environ, "ARMRIG_CLIENT_CERTIFICATE": str(lab.files.made / "bob.pem")},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _phases(lab: Lab) -> dict[str, str]:
    """Return the phase of each rig that `armrig ls --live` finds."""
    listing = _armrig(lab, "ls", "--live", "--connect", lab.files.endpoint, "--json")
    text, _ = listing.communicate(timeout=WITHIN_S)
    rigs = json.loads(text)["rigs"] if listing.returncode == 0 else []
    return {rig["rig"]: rig["status"]["phase"] for rig in rigs if rig["status"]}


def _tried(lab: Lab, *program: str) -> Tried:
    files = lab.files
    with routed(lab, *program), pytest.MonkeyPatch.context() as environ:
        environ.setenv("STRANGER_TIMES", str(FEW))
        with watching(lab.net, files.endpoint, files.made) as watcher:
            attempts = {
                who: stranger(lab.net, files.endpoint, files.made, who, pem)
                for who, pem in WHO.items()
            }
            by = {who: said(attempt) for who, attempt in attempts.items()}
        return Tried(by, said(watcher), lab.logs())


@pytest.fixture(scope="module")
def guarded(lab: Lab) -> Tried:
    """Return what everybody can do through the router."""
    return _tried(lab, *GUARDED)


@pytest.fixture(scope="module")
def unguarded(guarded: Tried, lab: Lab) -> Tried:
    """Return what everybody can do where nothing is denied there; the daemons are the same."""
    return _tried(lab, *UNGUARDED)


def _worked(counts: dict[str, int]) -> dict[str, int]:
    return {key: n for key, n in counts.items() if n}


@pytest.mark.parametrize(
    ("who", "links"), [("nobody", 0), ("forged", 0), ("wrong", FEW), ("rig-2", FEW)]
)
def test_a_client_without_permission_hears_and_does_nothing(
    guarded: Tried, who: str, links: int
) -> None:
    found = guarded.by[who]

    assert found["links"] == links
    for what in ("query", "liveliness", "subscribe", "tokens", "overhear"):
        assert _worked(found[what]) == {}, what


def test_people_do_what_the_access_list_says(guarded: Tried) -> None:
    allowed = {"bob": ["rig/1/cmd/status/bob"], "alice": command_keys("alice")}
    for who, commands in allowed.items():
        found = guarded.by[who]
        assert found["links"] == FEW
        assert _worked(found["query"]) == dict.fromkeys((*TOLD_KEYS, *commands), FEW)
        assert {"rig/1/sample", "rig/1/*", "rig/*/sample"} <= _worked(found["subscribe"]).keys()
        assert _worked(found["subscribe"]).keys() <= {*STREAM_KEYS, "rig/1/*", "rig/*/sample"}
        assert _worked(found["liveliness"]).keys() == {ALIVE, "rig/1/*"}
        assert _worked(found["overhear"]) == {}


def test_nothing_forged_reaches_a_listener(guarded: Tried) -> None:
    assert guarded.watcher["heard"]["rig/1/sample"] > 100
    assert _worked(guarded.watcher["forged"]) == {}


def test_no_command_was_taken_but_an_operator_s(guarded: Tried) -> None:
    taken = [line.split(": by ")[1] for line in guarded.log.splitlines() if ": by " in line]

    assert taken
    assert {who for who in taken if not who.startswith("certificate alice")} == set()


@pytest.mark.parametrize("who", WHO)
def test_without_the_guard_everybody_does_everything(unguarded: Tried, who: str) -> None:
    """The control: the same attempts, the same daemons, and all of them succeed."""
    found = unguarded.by[who]

    assert found["links"] == FEW
    assert set(command_keys(who)) | set(command_keys("alice")) <= _worked(found["query"]).keys()
    assert {"rig/1/sample", "rig/1/*", "rig/1/**", "**"} <= _worked(found["subscribe"]).keys()
    assert {ALIVE, "rig/1/*", "**"} <= _worked(found["liveliness"]).keys()
    forged = _worked(unguarded.watcher["forged"])
    assert forged[f"PUT {who}"] > FEW
    assert forged[f"TOKEN {FORGED}"] > 0
