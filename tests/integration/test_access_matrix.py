"""Permissions over a network: every client tries every operation of zenoh on every key.

Each cell is tried 20 times, from a network namespace of its own. As the control the same attempts
succeed without the guard, so that an empty cell is evidence.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.integration import namespaces
from tests.integration.laboratory import by_certificate, certificates
from tests.integration.namespaces import Namespaces
from tests.integration.processes import Bench
from tests.integration.remote_rig import GUARDED, PORT, UNGUARDED, said, started, stranger, watching
from tests.integration.stranger import (
    ALIVE,
    FORGED,
    STREAM_KEYS,
    TIMES,
    TOLD_KEYS,
    command_keys,
    every_key,
)

pytestmark = pytest.mark.machine
WHO = {
    "nobody": "",
    "forged": "forged.pem",
    "expired": "expired.pem",
    "wrong": "wrong.pem",
    "eve": "eve.pem",
    "bob": "bob.pem",
    "alice": "alice.pem",
}
NOT_LET_IN = ("nobody", "forged", "expired")
ON_NO_LIST = ("wrong", "eve")


class Tried(NamedTuple):
    """Results of all attempts."""

    by: dict[str, dict[str, Any]]
    watcher: dict[str, dict[str, int]]
    log: str


@pytest.fixture(scope="module")
def line() -> Iterator[Namespaces]:
    """Give two machines."""
    if why := namespaces.missing():
        pytest.skip(why)
    with namespaces.connected() as both:
        yield both


@pytest.fixture(scope="module")
def guarded(line: Namespaces, tmp_path_factory: pytest.TempPathFactory) -> Tried:
    """Return what everybody can do to the daemon."""
    return _tried(line, tmp_path_factory.mktemp("guarded"), *GUARDED)


@pytest.fixture(scope="module")
def unguarded(line: Namespaces, tmp_path_factory: pytest.TempPathFactory) -> Tried:
    """Return what everybody can do where nothing is denied."""
    return _tried(line, tmp_path_factory.mktemp("open"), *UNGUARDED)


def _tried(line: Namespaces, folder: Path, *program: str) -> Tried:
    bench = Bench(folder)
    made = certificates(folder)
    where = by_certificate(bench, made, f"tls/{namespaces.ADDRESSES['rig']}:{PORT}")
    try:
        bench.emulate()
        with started(line, bench, *program) as log:
            with watching(line, where, made) as watcher:
                attempts = {who: stranger(line, where, made, who, pem) for who, pem in WHO.items()}
                by = {who: said(attempt) for who, attempt in attempts.items()}
            return Tried(by, said(watcher), log.read_text())
    finally:
        bench.end()


def _worked(counts: dict[str, int]) -> dict[str, int]:
    return {key: n for key, n in counts.items() if n}


@pytest.mark.parametrize("who", NOT_LET_IN)
def test_a_client_without_a_valid_certificate_is_refused(guarded: Tried, who: str) -> None:
    found = guarded.by[who]

    assert found["links"] == 0
    for what in ("query", "liveliness", "subscribe", "tokens", "overhear"):
        assert _worked(found[what]) == {}, what


@pytest.mark.parametrize("who", ON_NO_LIST)
def test_a_client_on_no_list_hears_and_does_nothing(guarded: Tried, who: str) -> None:
    found = guarded.by[who]

    assert found["links"] == TIMES
    for what in ("query", "liveliness", "subscribe", "tokens", "overhear"):
        assert _worked(found[what]) == {}, what


def test_an_observer_hears_the_rig_and_asks_for_its_state(guarded: Tried) -> None:
    found = guarded.by["bob"]

    assert found["links"] == TIMES
    assert _worked(found["query"]) == dict.fromkeys((*TOLD_KEYS, "rig/1/cmd/status/bob"), TIMES)
    assert _heard_only(found, {*STREAM_KEYS, "rig/1/*"})
    assert _worked(found["liveliness"]) == dict.fromkeys((ALIVE, "rig/1/*"), TIMES)
    # The stranger's own session delivers its token to each of its matching subscribers.
    assert min(found["tokens"][key] for key in (ALIVE, "rig/1/*")) > TIMES / 2
    assert _worked(found["overhear"]) == {}


def test_an_operator_commands_under_their_own_name(guarded: Tried) -> None:
    found = guarded.by["alice"]

    assert found["links"] == TIMES
    assert _worked(found["query"]) == dict.fromkeys((*TOLD_KEYS, *command_keys("alice")), TIMES)
    assert _heard_only(found, {*STREAM_KEYS, "rig/1/*"})
    assert _worked(found["liveliness"]) == dict.fromkeys((ALIVE, "rig/1/*"), TIMES)
    assert _worked(found["overhear"]) == {}


def _heard_only(found: dict[str, Any], keys: set[str]) -> bool:
    """Return whether samples arrived in most rounds, and from no other key than these."""
    heard = _worked(found["subscribe"])
    return min(heard["rig/1/sample"], heard["rig/1/*"]) > TIMES / 2 and heard.keys() <= keys


def test_a_listener_hears_nobody_else(guarded: Tried) -> None:
    """A watcher met none of 10 000 forgeries: no sample, no token, no reply."""
    assert guarded.watcher["heard"]["rig/1/sample"] > 100
    assert _worked(guarded.watcher["forged"]) == {}


def test_no_command_was_taken_but_an_operator_s(guarded: Tried) -> None:
    taken = [line.split(": by ")[1] for line in guarded.log.splitlines() if ": by " in line]

    assert taken
    assert {who for who in taken if not who.startswith("certificate alice")} == set()


@pytest.mark.parametrize("who", WHO)
def test_without_the_guard_everybody_does_everything(unguarded: Tried, who: str) -> None:
    """The control: the same attempts, and all of them succeed."""
    found = unguarded.by[who]

    assert found["links"] == TIMES
    assert set(command_keys(who)) | set(command_keys("alice")) <= {
        key for key, n in found["query"].items() if n == TIMES
    }
    assert {"rig/1/sample", "rig/1/*", "rig/1/**", "**"} <= _worked(found["subscribe"]).keys()
    assert {ALIVE, "rig/1/*", "**"} <= _worked(found["liveliness"]).keys()
    forged = _worked(unguarded.watcher["forged"])
    assert forged[f"PUT {who}"] > TIMES
    assert forged[f"DELETE {who}"] > TIMES


def test_without_the_guard_tokens_and_replies_are_forged(unguarded: Tried) -> None:
    """The control of the watcher."""
    forged = _worked(unguarded.watcher["forged"])

    assert forged[f"TOKEN {FORGED}"] > 0
    assert any(_worked(found["overhear"]) for found in unguarded.by.values())


def test_every_key_of_the_rig_was_tried() -> None:
    keys = every_key("bob")

    assert len(keys) == len(set(keys))
    assert {*STREAM_KEYS, ALIVE, *TOLD_KEYS, *command_keys("bob")} <= set(keys)
