"""uvicorn's server in a thread."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import uvicorn

from armrig.dashboard.connections import Connections
from armrig.dashboard.stream import Stream
from armrig.rig.session import RigError

_START_S = 20.0
_ENDS_S = 2
QUIET: dict[str, Any] = {
    "log_config": None,
    "log_level": "error",  # of what is not HTTP anybody could have it warn
    "access_log": False,
    "lifespan": "off",
    "ws": "none",
    "server_header": False,
    "date_header": False,
    "proxy_headers": False,
    "timeout_graceful_shutdown": _ENDS_S,
    "timeout_keep_alive": 30,
    "h11_max_incomplete_event_size": 16_384,
}
"""How uvicorn is set: it prints nothing, says nothing of itself, and ends soon."""


class Server(uvicorn.Server):
    """uvicorn's server, which leaves the signals to who calls."""

    def __init__(
        self, config: uvicorn.Config, listening: socket.socket, connections: Connections
    ) -> None:
        super().__init__(config)
        self._listening, self._connections = listening, connections

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture none: the command line ends us."""
        yield

    async def run_here(self) -> None:
        """Serve until `should_exit`."""
        await self.serve([self._listening])
        # Who does not read his last messages would keep his connection open.
        self._connections.end()
        await asyncio.sleep(0)  # they are closed in the loop's next turn


class ServerThread:
    """The loop of one door's server: what besieges a door takes nothing from the other."""

    def __init__(self, server: Server, stream: Stream) -> None:
        self._server, self._stream = server, stream
        self._thread = threading.Thread(target=self._run, name="server", daemon=True)

    def begin(self) -> None:
        """Begin, and wait until it listens."""
        # As uvicorn's: whoever breaks off what he reads would have a line on the terminal.
        logging.getLogger("asyncio").setLevel(logging.ERROR)
        self._thread.start()
        pause = threading.Event()
        for _ in range(int(_START_S / 0.01)):
            if self._server.started:
                return
            pause.wait(0.01)
        raise RigError("the server does not start")

    def end(self) -> None:
        """End, and wait for it."""
        self._server.should_exit = True
        self._thread.join(_ENDS_S + 5.0)

    def _run(self) -> None:
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        filling = asyncio.create_task(self._stream.fill())
        ending = asyncio.create_task(self._end_streams())
        try:
            await self._server.run_here()
        finally:
            for task in (filling, ending):
                task.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await task

    async def _end_streams(self) -> None:
        """End the streams as soon as the server is to end, which waits for them."""
        while not self._server.should_exit:
            await asyncio.sleep(0.05)
        self._stream.viewers.end()
