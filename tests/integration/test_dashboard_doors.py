"""Further doors of the dashboard: one for visitors, and one for Foxglove."""

from __future__ import annotations

import base64
import itertools
import json
import os
import re
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from armrig.dashboard.serving import DashboardSettings, dashboard
from armrig_core.rig.description import builtin
from armrig_core.telemetry.telemetry import decode_sample

from tests.integration.driving import hold
from tests.integration.processes import WITHIN_S, Bench, wait_for
from tests.integration.watching import Client
from tests.layouts import Kinds, foxglove_paths, kinds, plotjuggler_curves, snippets

ADDRESS = "127.0.0.1"  # a visitor's; of a network in `armrig dashboard --share`


@pytest.fixture
def doors(served: Bench) -> Iterator[tuple[Client, Client]]:
    """Give who may command, and a visitor."""
    pytest.importorskip("cryptography", reason="no cryptography: no certificate for visitors")
    with dashboard(DashboardSettings(connect=served.endpoint, share=ADDRESS)) as found:
        own, visitor = Client(found.url), Client(found.shared_url)
        own.wait("live", lambda seen: not seen["is_stale"])
        yield own, visitor


def test_a_visitor_can_watch_and_stop(doors: tuple[Client, Client], served: Bench) -> None:
    _, visitor = doors
    assert visitor.first("hello")["may_command"] is False
    assert not visitor.first("live")["is_stale"]
    with served.rig() as other:
        hold(other, served, 1.0, "somebody")
        assert visitor.ask("/api/stop", {"owner": "a visitor"})[0] == 200
        wait_for(lambda: served.volts() == 0.0)


def test_a_visitor_has_no_command_except_stop(doors: tuple[Client, Client], served: Bench) -> None:
    own, visitor = doors
    rest = ("note", "preview", "recordings", "mcap", "identify", "models/data", "models/estimate")
    for command in ("arm", "release", "reset", "run", *rest):
        assert visitor.ask(f"/api/{command}", {"owner": "x"})[0] == 404
        stolen = f"Bearer {visitor.token}"
        assert own.ask(f"/api/{command}", {"owner": "x"}, Authorization=stolen)[0] == 403
    assert visitor.token != own.token
    assert served.settled() == "safe"


def test_a_visitor_s_port_refuses_requests_without_tls(doors: tuple[Client, Client]) -> None:
    _, visitor = doors
    plain = Client(visitor.url.replace("https:", "http:"))
    with pytest.raises(OSError):  # noqa: PT011  # reset, or closed
        plain.ask("/api/stop", {})


def _heard(link: Any, most: int) -> tuple[dict[str, Any], list[dict[str, Any]], list[bytes]]:
    """Return greeting, channels and payloads of samples, as they come at a plain socket."""
    greeting: dict[str, Any] = {}
    channels: list[dict[str, Any]] = []
    payloads: list[bytes] = []
    sample = -1
    while len(payloads) < most:
        message = link.recv(timeout=WITHIN_S)
        if isinstance(message, str):
            told = json.loads(message)
            if told["op"] == "serverInfo":
                greeting = told
            elif told["op"] == "advertise":
                channels += told["channels"]
                wanted = [c["id"] for c in told["channels"] if c["topic"] == "/rig/1/sample"]
                if wanted:
                    (sample,) = wanted
                    asked = {"op": "subscribe", "subscriptions": [{"id": 7, "channelId": sample}]}
                    link.send(json.dumps(asked))
        elif message[:1] == b"\x01":  # message data: subscription, time, payload
            (subscription, _) = struct.unpack_from("<IQ", message, 1)
            assert subscription == 7
            payloads.append(message[13:])
    return greeting, channels, payloads


def test_foxglove_receives_the_signals_of_its_layout_and_cannot_command(served: Bench) -> None:
    pytest.importorskip("foxglove", reason="no foxglove-sdk")
    sync_client = pytest.importorskip("websockets.sync.client", reason="no websockets")
    from armrig.dashboard.foxglove import foxglove

    before = served.voltage_changes()
    with foxglove(builtin("arm"), rig="1", connect=served.endpoint, port=0) as url:
        protocol = sync_client.Subprotocol("foxglove.sdk.v1")
        with sync_client.connect(url, subprotocols=[protocol], proxy=None) as link:
            greeting, channels, payloads = _heard(link, 20)
            for attack in (
                {"op": "advertise", "channels": [{"id": 1, "topic": "/rig/1/cmd/arm"}]},
                {"op": "setParameters", "parameters": [{"name": "u", "value": 5}]},
                {"op": "subscribeConnectionGraph"},
            ):
                link.send(json.dumps(attack))
            link.send(b"\x01" + struct.pack("<I", 1) + b'{"owner":"x"}')
            _heard(link, 20)  # by now all that was read

    samples = [decode_sample(payload) for payload in payloads]
    assert greeting["capabilities"] == []
    there = Kinds()
    for c in channels:
        there |= kinds(c["topic"], c["schemaName"], base64.b64decode(c["schema"]))
    assert foxglove_paths().items() <= there.items()
    assert {c["topic"] for c in channels} >= {"/rig/1/sample", "/rig/1/state", "/rig/1/gap"}
    ks = [s.k for s in samples if s is not None]
    assert len(ks) == 20
    assert all(b - a >= 1 for a, b in itertools.pairwise(ks))
    assert served.settled() == "safe"
    assert served.voltage_changes() == before


def test_the_program_of_the_page_sends_the_signals_of_plotjuggler_s_layout(served: Bench) -> None:
    """PlotJuggler joins the keys of nested JSON by slashes; a NaN would end its server."""
    page = Path(__file__).parents[2] / "docs" / "dashboard.md"
    (program,) = re.findall(r"```python\n(# plot\.py.*?)```", page.read_text("utf-8"), re.DOTALL)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plotjuggler:
        plotjuggler.bind((ADDRESS, 0))
        plotjuggler.settimeout(WITHIN_S)
        text = program.replace("9870", str(plotjuggler.getsockname()[1]))
        settings = {"ARMRIG_CLIENT_CONNECT": served.endpoint}
        with subprocess.Popen([sys.executable, "-c", text], env=os.environ | settings) as running:
            try:
                sent = json.loads(plotjuggler.recv(65_536), parse_constant=pytest.fail)
            finally:
                running.kill()

    names = {f"/rig/1/sample/{name}" for name in sent["rig"]["1"]["sample"]}
    curves, sources = plotjuggler_curves()
    of_samples = {c for c in curves - set(snippets()) | sources if c.startswith("/rig/1/sample/")}
    assert len(of_samples) == 3
    assert of_samples <= names
