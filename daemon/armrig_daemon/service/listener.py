"""One zenoh session of the service at one endpoint: publishes streams, receives commands.

The session listens at the endpoint, or is connected to a router. Each endpoint has a separate
session. Clients of the Unix socket are therefore not affected by the limits of a network's
listener: number of links and rate of queries.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import msgspec
import zenoh
from armrig_core.access import access_control
from armrig_core.access.owned_session import (
    LANES,
    NOT_FOUND,
    group_may_open,
    listening,
    session_configuration,
    strangers,
    transport,
)
from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import (
    REQUESTS,
    Refused,
    Renew,
    StopRequest,
    build_refusal,
    json_schema,
)
from armrig_core.rig.channels import DeviceChannel
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.channels import CHANNELS
from armrig_core.telemetry.history import HistoryRequest
from armrig_core.telemetry.topics import (
    STREAMS,
    alive_key,
    command_key,
    history_key,
    schema_key,
    stream_key,
)

from armrig_daemon.service import admission
from armrig_daemon.service.access import Network

URGENT = (StopRequest.name, Renew.name)
"""Commands with a separate thread of zenoh, so that they wait for no other command."""
_SCHEMA, _HISTORY = "schema", "history"
_COUNTED = (*REQUESTS, _SCHEMA, _HISTORY)
MAX_LINKS = 250
"""Largest number of simultaneous links over a network."""
_RETRY_MS = 1000  # longest time between two attempts to connect to a lost router
_MAX_QUESTION_BYTES = 64  # longest request for the history


def session_config(endpoint: str, network: Network | None = None) -> zenoh.Config:
    """Return the configuration of a session that uses only `endpoint`, without scouting."""
    if network is not None and network.is_router:
        return zenoh.Config.from_json5(json.dumps(_router_config(network)))
    if network is None:
        config = session_configuration(endpoint, most_received=access_control.MOST_LOCAL_BYTES)
    else:
        config = session_configuration(endpoint, most_received=access_control.MOST_MESSAGE_BYTES)
        config |= listening(endpoint)
        config["transport"]["unicast"] = strangers(MAX_LINKS)
        config["access_control"] = network.access_control
        config["low_pass_filter"] = network.low_pass_filter
        config["transport"]["link"]["tls"] = network.tls
    return zenoh.Config.from_json5(json.dumps(config))


def _router_config(network: Network) -> dict[str, Any]:
    """Return the configuration of a router's client; the client reconnects by itself."""
    config = {
        "mode": "client",
        "connect": {"endpoints": [network.endpoint], "retry": {"period_max_ms": _RETRY_MS}},
        **NOT_FOUND,
        "access_control": network.access_control,
        "low_pass_filter": network.low_pass_filter,
        "qos": LANES,
        "transport": transport(access_control.MOST_MESSAGE_BYTES),
    }
    config["transport"]["link"]["tls"] = network.tls
    return config


class Command:
    """Query that waits for its answer; each query gets exactly one answer."""

    def __init__(self, name: str, query: zenoh.Query, by: str = "") -> None:
        self.name = name
        self.by = by
        """Client that zenoh has verified, such as `certificate alice`; "" on the Unix socket."""
        self._key = str(query.key_expr)
        self._query: zenoh.Query | None = query
        self.came_s = time.monotonic()
        self.payload = query.payload.to_bytes() if query.payload is not None else b""

    def answer(self, body: Any) -> None:
        """Answer with JSON."""
        query, self._query = self._query, None
        if query is not None:
            query.reply(self._key, msgspec.json.encode(body), encoding="application/json")
            query.drop()

    def refuse(self, refusal: Refused) -> None:
        """Answer with a refusal."""
        query, self._query = self._query, None
        if query is not None:
            _refuse(query, refusal)


class Listener:
    """An open session at one endpoint, or with one router."""

    def __init__(
        self,
        endpoint: str,
        rig: str,
        admit: Callable[[Command], None],
        past: Callable[[int, int], bytes],
        network: Network | None = None,
        channels: tuple[DeviceChannel, ...] = CHANNELS,
    ) -> None:
        """Listen at the endpoint, or connect to the router.

        zenoh's threads call `admit` with each command that passes the limits. `past` returns the
        answer to a request for the history; its arguments are the number of the first requested
        message, and the offset of the clocks in ns. `network` is a network endpoint with its
        permissions; None is the Unix socket. `channels` name fields of the schema of a sample.

        Raises zenoh.ZError if the endpoint is in use or cannot be opened, or the router does not
        answer.
        """
        self._admit = admit
        self._is_network = network is not None
        self._buckets: dict[str, admission.Bucket] = {}
        # A network endpoint creates no socket file. It therefore needs no `group_may_open`, which
        # admits only one session at a time.
        with group_may_open() if network is None else nullcontext():
            self._session = zenoh.open(session_config(endpoint, network))
        self._publishers = {
            stream: self._session.declare_publisher(
                stream_key(rig, stream),
                encoding=f"application/protobuf;{protobuf.OF_STREAM[stream]}",
                congestion_control=zenoh.CongestionControl.DROP,
            )
            for stream in STREAMS
        }
        self._served = {
            schema_key(rig, n): protobuf.descriptor_set(n, channels)
            for n in protobuf.OF_STREAM.values()
        }
        for name in REQUESTS:
            self._served[schema_key(rig, f"cmd/{name}")] = json_schema(name)
        self._past, self._history_key = past, history_key(rig)
        asker = "*" if network is not None else ""
        served = {
            self._history_key: self._serve_history,
            schema_key(rig, "**"): self._serve_schema,
            command_key(rig, "*", asker): self._receive,
            **{command_key(rig, name, asker): self._receive_urgent for name in URGENT},
        }
        for key, answer in served.items():
            self._session.declare_queryable(key, answer)
        self._alive = self._session.liveliness().declare_token(alive_key(rig))

    def close(self) -> None:
        """Close the session; with an open session the interpreter would never end."""
        self._session.close()

    @property
    def has_router(self) -> bool:
        """True while a router is connected."""
        return bool(self._session.info.routers_zid())

    def put(self, stream: str, data: bytes) -> None:
        """Publish; zenoh drops the message for a subscriber that does not keep up."""
        self._publishers[stream].put(data)

    def _serve_schema(self, query: zenoh.Query) -> None:
        if self._is_too_many(_SCHEMA):
            _refuse(query, admission.too_many(_SCHEMA))
            return
        with query:
            for key, data in self._served.items():
                if query.key_expr.intersects(zenoh.KeyExpr(key)):
                    query.reply(key, data)

    def _serve_history(self, query: zenoh.Query) -> None:
        if self._is_too_many(_HISTORY):
            _refuse(query, admission.too_many(_HISTORY))
            return
        payload = query.payload.to_bytes()[:_MAX_QUESTION_BYTES] if query.payload else b"{}"
        try:
            asked = msgspec.json.decode(payload, type=HistoryRequest)
        except (msgspec.DecodeError, UnicodeDecodeError) as err:
            text = f'history: {err}; ask with {{"first": 0}}'
            _refuse(query, build_refusal(RefusalCode.NOT_ALLOWED, text))
            return
        offset_ns = time.time_ns() - time.monotonic_ns()
        reply = self._past(asked.first, offset_ns)
        query.reply(self._history_key, reply)
        query.drop()

    def _receive(self, query: zenoh.Query) -> None:
        name, _ = self._parts(query)
        if name in URGENT:
            query.drop()  # the separate queryable of the command also gets the query
        elif name not in admission.LEASED and self._is_too_many(name):
            _refuse(query, admission.too_many(name))
        else:
            self._receive_urgent(query)

    def _receive_urgent(self, query: zenoh.Query) -> None:
        name, by = self._parts(query)
        self._admit(Command(name, query, by))

    def _parts(self, query: zenoh.Query) -> tuple[str, str]:
        """Return the names of command and client; the client's name is empty on the Unix socket."""
        key = str(query.key_expr)
        if not self._is_network:
            return key.rsplit("/", 1)[-1], ""
        _, name, asker = key.rsplit("/", 2)
        return name, f"certificate {asker}"

    def _is_too_many(self, name: str) -> bool:
        """Count a query, in the thread of its queryable; return whether it exceeds the limit."""
        kind = name if name in _COUNTED else ""  # all unknown names are of one kind
        bucket = self._buckets.get(kind, admission.Bucket())
        left = admission.take(bucket, time.monotonic(), admission.PER_S, admission.BURST)
        if left is not None:
            self._buckets[kind] = left
        return left is None


def _refuse(query: zenoh.Query, refusal: Refused) -> None:
    query.reply_err(msgspec.json.encode(refusal), encoding="application/json")
    query.drop()
