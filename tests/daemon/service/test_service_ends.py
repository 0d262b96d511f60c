"""The start of the service's loop, the exit code of the service, and its reload."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from armrig_core.errors import InputError
from armrig_core.process.line_writer import LineWriter
from armrig_daemon.config import Config
from armrig_daemon.loop.process import NO_PORT, LoopSettings
from armrig_daemon.pipe import Quit
from armrig_daemon.service import service as service_module
from armrig_daemon.service.service import Service
from msgspec.structs import replace

from tests.daemon.odd_bench import CONFIG
from tests.daemon.service.opened_run import open_run
from tests.daemon.service.test_service_between import FREE, RUN, Between
from tests.integration.processes import wait_for


class _Started(Exception):  # noqa: N818 - no error
    """Raised instead of the start of a loop."""


@pytest.fixture
def between(tmp_path: Path) -> Iterator[Between]:
    """Return a service without a loop, which reloads its configuration at SIGHUP."""
    between = Between(tmp_path)
    between.service._check_configuration = Config
    yield between
    between.close()


def test_the_loop_is_started_with_the_options_of_the_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loop stops the motor after 3 s without the service."""
    config = replace(
        CONFIG,
        device=replace(CONFIG.device, port="/dev/odd"),
        timing=replace(CONFIG.timing, priority=33, cpu=2, spin_us=77.5),
    )

    def start(settings: LoopSettings, _: int) -> None:
        raise _Started(settings)

    monkeypatch.setattr(service_module.child, "start", start)
    service = Service(config, "unixsock-stream/nowhere", tmp_path)
    with pytest.raises(_Started) as started:
        service.run()
    service._signals.close()

    assert started.value.args == (
        LoopSettings(
            rules=replace(config.rules(), service_ns=3_000_000_000),
            port="/dev/odd",
            baud=250_000,
            priority=33,
            cpu=2,
            spin_ns=77_500,
        ),
    )


@pytest.mark.parametrize(
    ("code", "quits", "restarts", "exit_code"),
    [
        (0, True, False, 0),
        (0, True, True, 75),
        (1, True, True, 1),
        (-9, True, False, 1),
        (-9, False, False, 1),
        (0, False, False, 1),
        (NO_PORT, False, False, 78),
        (NO_PORT, True, False, 1),
    ],
)
def test_a_service_ends_with_the_exit_code_that_systemd_expects(
    code: int,
    quits: bool,
    restarts: bool,
    exit_code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    loop = SimpleNamespace(starter=SimpleNamespace(number=1), end=lambda: code)
    monkeypatch.setattr(service_module.child, "start", lambda *_: loop)
    monkeypatch.setattr(service_module, "Session", lambda *_: nullcontext())
    monkeypatch.setattr(service_module.sys, "setswitchinterval", lambda _: None)
    monkeypatch.setattr(service_module.open_files, "raise_limit", lambda: None)
    for name in ("leave_fifo", "be_prompt", "ignore_signals"):
        monkeypatch.setattr(service_module.realtime, name, lambda *_, **__: True)
    log = LineWriter()
    service = Service(Config(), "unixsock-stream/nowhere", tmp_path, log=log)
    for name in ("_connect", "_announce", "_serve"):
        setattr(service, name, lambda *_, **__: None)
    service._quitting, service._restarts = quits, restarts

    assert service.run() == exit_code

    service._signals.close()
    log.close()
    told = "" if quits or code == NO_PORT else f"the loop died with code {code}: the device stops"
    assert told in (said := capsys.readouterr().err)
    assert bool(said) == bool(told)


def _hung_up(between: Between) -> list[Any]:
    """Send SIGHUP to the service; return its orders to end the loop."""
    between.loop.orders()
    signal.raise_signal(signal.SIGHUP)
    between.service._handle_wake()
    wait_for(lambda: between.service._disk.hand_back() or not between.service._disk.waiting)
    return [order for order in between.loop.orders() if isinstance(order, Quit)]


@pytest.mark.parametrize("busy_with", ["an owner", "a run", "a command"])
def test_a_rig_in_use_is_not_reloaded(
    between: Between, busy_with: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if busy_with == "an owner":
        between.service._handle([replace(FREE, owner="group 3")])
        who = "group 3 has the rig"
    else:
        who = "a run or a command is in progress"
    if busy_with == "a run":
        open_run(between.service._runs, RUN, 0.01)
    if busy_with == "a command":
        between.ask(RUN)
        between.commands.serve()
        between.service._runs.forget(between.service._runs.run_id)

    assert _hung_up(between) == []
    assert not between.service._restarts
    told = f"warning: configuration not reloaded: {who}; reload when the rig is free\n"
    assert told in capsys.readouterr().err


def test_a_free_rig_is_reloaded_by_a_new_start(between: Between) -> None:
    assert _hung_up(between) == [Quit(reason="the configuration is reloaded")]
    assert (between.service._restarts, between.service._quitting) == (True, True)


def test_a_configuration_that_is_refused_is_not_loaded(
    between: Between, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse() -> Config:
        raise InputError("Ts = 7 is too long")

    between.service._check_configuration = refuse

    assert _hung_up(between) == []
    assert not between.service._restarts
    told = "not reloaded, the old configuration stays: Ts = 7 is too long"
    assert told in capsys.readouterr().err


def test_a_service_that_was_not_started_by_systemd_ends_at_a_hangup(between: Between) -> None:
    between.service._check_configuration = None

    assert _hung_up(between) == [Quit(reason="the service received a signal to end")]
    assert (between.service._restarts, between.service._quitting) == (False, True)
