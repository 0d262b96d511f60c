"""A client that asks again and again and reads no answer.

`python deaf_client.py TARGET KEY SIZE CREDENTIAL` connects through a relay of its
own to TARGET, a path or HOST:PORT. The relay then reads nothing more. The client queries KEY with
SIZE bytes, and prints "there" after `QUERIES` queries. If the listener ends the link, the client
connects again.
"""

from __future__ import annotations

import json
import os
import socket
import sys
import threading
import time
from pathlib import Path
from typing import Any

import zenoh
from armrig_core.access.credential import read_credential

QUERIES = 1500  # more answers than the queues of zenoh and of the kernel hold
_RECEIVED = 4096  # B; a small buffer is soon full
_PAUSE_S = 0.0005


class Relay:
    """Relay of one connection, which reads the listener's bytes until `is_deaf`."""

    def __init__(self, target: str) -> None:
        self.is_deaf, self.is_over = threading.Event(), threading.Event()
        self._listening = socket.create_server(("localhost", 0))
        self._family = socket.AF_UNIX if target.startswith("/") else socket.AF_INET
        host, _, port = target.rpartition(":")
        self._target: Any = target if target.startswith("/") else (host, int(port))
        self.port = self._listening.getsockname()[1]
        threading.Thread(target=self._carry, daemon=True).start()

    def _carry(self) -> None:
        client, _ = self._listening.accept()
        with client, socket.socket(self._family) as listener:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVED)
            listener.connect(self._target)
            threading.Thread(target=self._forward, args=(client, listener), daemon=True).start()
            while not self.is_deaf.is_set():
                client.sendall(listener.recv(1 << 16))
            self.is_over.wait()

    def _forward(self, client: socket.socket, listener: socket.socket) -> None:
        try:
            while data := client.recv(1 << 16):
                listener.sendall(data)
        except OSError:
            pass  # the listener has ended the link
        self.is_over.set()


def opened(relay: Relay, credential: str) -> zenoh.Session:
    """Return a session through the relay."""
    config: dict[str, Any] = {"mode": "client", "scouting": {"multicast": {"enabled": False}}}
    config["connect"] = {"endpoints": [f"tcp/localhost:{relay.port}"], "timeout_ms": 10_000}
    if credential:
        tls = read_credential(Path(credential), "client").tls("connect")
        config["connect"]["endpoints"] = [f"tls/localhost:{relay.port}"]
        config["transport"] = {"link": {"tls": tls}}
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


def main(target: str, key: str, size: str, credential: str = "") -> None:
    """Query until the parent ends."""
    parent, sent = os.getppid(), 0
    unread = zenoh.handlers.Callback(lambda reply: None, indirect=False)
    while os.getppid() == parent:
        relay = Relay(target)
        session = opened(relay, credential)
        session.declare_subscriber("rig/1/*", unread)
        session.liveliness().get("rig/1/alive", unread)
        relay.is_deaf.set()
        while os.getppid() == parent and not relay.is_over.is_set():
            session.get(key, unread, payload=b"{" + b" " * int(size) + b"}", timeout=60.0)
            sent += 1
            if sent == QUERIES:
                print("there", flush=True)
            time.sleep(_PAUSE_S if sent < QUERIES else 10 * _PAUSE_S)
        threading.Thread(target=session.close, daemon=True).start()
    os._exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:])
