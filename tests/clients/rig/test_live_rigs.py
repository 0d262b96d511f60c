"""The rigs whose daemons run: all of them, by id, each with its status or with the reason."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from armrig.rig import status
from armrig.rig.session import Connection, NoReplyError
from armrig.rig.status import ids_alive, live_rigs
from armrig_core.commands.commands import OutputRange
from armrig_core.telemetry.topics import alive_key

from tests.clients.fake_daemon import FakeDaemon, status_report


class _Session:
    """Session of an endpoint, with the rigs there and what each answers."""

    def __init__(self, **answers: Any) -> None:
        self._answers = {name.replace("_", "-"): answer for name, answer in answers.items()}

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass

    def liveliness(self) -> Any:
        """Return the tokens: each twice, the last of the table first."""
        keys = [alive_key(rig) for rig in reversed(self._answers)] * 2
        replies = [SimpleNamespace(ok=SimpleNamespace(key_expr=key)) for key in keys]
        return SimpleNamespace(get=lambda *_, **__: [SimpleNamespace(ok=None), *replies])

    def get(self, key: str, **_: Any) -> Iterator[Any]:
        answer = self._answers[key.split("/")[1]]
        sent = SimpleNamespace(to_bytes=lambda: answer)
        if answer.startswith(b'{"rig"'):
            yield SimpleNamespace(ok=SimpleNamespace(payload=sent), err=None)
        elif answer:
            said = type("Payload", (SimpleNamespace,), {"__str__": lambda _: answer.decode()})
            yield SimpleNamespace(ok=None, err=SimpleNamespace(payload=said(**vars(sent))))


def _status(rig: str) -> bytes:
    return msgspec.json.encode(FakeDaemon("there", rig).status())


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Give a function that sets what this machine has configured, and what opens."""

    def has(**names: Any) -> None:
        for name, value in names.items():
            monkeypatch.setattr(status, name, value)

    return has


def test_the_ids_of_live_rigs_are_sorted_and_unique(
    machine: Callable[..., None],
) -> None:
    session: Any = _Session(lab_9=b"", a=b"", lab_10=b"", z=b"", m=b"", lab_1=b"", c=b"", b=b"")

    assert ids_alive(session) == ["a", "b", "c", "lab-1", "lab-10", "lab-9", "m", "z"]
    machine(MOST_RIGS=3)
    assert ids_alive(session) == ["a", "b", "c"]


def test_each_rig_at_an_endpoint_has_its_own_status_or_the_reason(
    machine: Callable[..., None],
) -> None:
    session: Any = _Session(
        c=_status("c"), a=b"", d=b"Timeout", b=_status("b"), e=b'{"error": "not permitted"}'
    )
    machine(
        connect_setting=lambda: "tls/configured:1",
        open_endpoint=lambda at: Connection(session, at, ""),
    )

    where, found = live_rigs("tls/lab:7447")

    assert where == "tls/lab:7447"
    assert {one.endpoint for one in found} == {where}
    assert [(one.rig, one.status and one.status.rig, one.why) for one in found] == [
        ("a", None, "does not answer"),
        ("b", "b", ""),
        ("c", "c", ""),
        ("d", None, "does not answer"),
        ("e", None, "not permitted"),
    ]
    assert live_rigs(None)[0] == "tls/configured:1"


def test_an_unreachable_rig_of_this_machine_hides_no_other(
    machine: Callable[..., None],
) -> None:
    def opened(_: None, *, rig: str) -> Connection:
        if rig in ("a", "c"):
            raise NoReplyError(f"rig {rig} is gone")
        session: Any = _Session(**{rig: _status(rig)})
        return Connection(session, f"socket of {rig}", "")

    machine(
        connect_setting=lambda: "",
        local_rigs=lambda: ["a", "b", "c", "d"],
        default_endpoint=lambda rig: f"default of {rig}",
        open_connection=opened,
    )

    where, found = live_rigs(None)

    assert where == "this machine"
    assert [(one.rig, one.endpoint, one.status is not None, one.why) for one in found] == [
        ("a", "default of a", False, "rig a is gone"),
        ("b", "socket of b", True, ""),
        ("c", "default of c", False, "rig c is gone"),
        ("d", "socket of d", True, ""),
    ]


def test_the_row_of_the_limits_names_each_limited_output() -> None:
    ranges = {"theta_1": OutputRange(turns=3), "alpha": OutputRange(low=-0.5, high=0.5)}

    rows = dict(status.status_rows(status_report(u_max=4.5, limits=ranges)))

    assert rows["limits"] == (
        "0 to 4.5 V; theta_1 less than 3 turns in a run; alpha at least -0.5 rad, at most 0.5 rad"
    )
