"""Routes of the server: the page, its stream, and commands to the rig."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Any

import msgspec
from armrig_core.commands.commands import LONGEST_TS
from armrig_core.errors import FileError, InputError, ParameterError
from msgspec import Meta
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from armrig.dashboard.driver import BusyDriverError, CommandSender
from armrig.dashboard.experiments import UNMONITORED, ExperimentRequest, plan_of, previewed
from armrig.dashboard.feed import Feed
from armrig.dashboard.guard import Connections
from armrig.dashboard.laws import law_rows, recordings_folder
from armrig.dashboard.page_json import page_json
from armrig.dashboard.stream import Stream, TooManyViewersError, Viewer
from armrig.recordings.files.recording_summary import path_text
from armrig.rig.session import RigError

_Owner = Annotated[str, Meta(min_length=1, max_length=80)]
# A visitor cannot choose the name that the recording stores.
_VISITOR = "a visitor of the dashboard"
Answer = Callable[[Request], Awaitable[Response]]
_LABELS = {"seconds": "length", "at": "step at", "Ts": "sampling time", "high": "upper level"}
"""Labels in the page's form, for the parameters whose label differs from their name."""
_TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
    "LICENSE": "text/plain; charset=utf-8",
}
_PAGE = Path(__file__).parent / "page"


class _Stopped(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    owner: Annotated[str, Meta(max_length=80)] = ""


class _Armed(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    owner: _Owner
    Ts: Annotated[float, Meta(gt=0, le=LONGEST_TS)] | None = None


class _OwnedExperiment(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    owner: _Owner
    experiment: ExperimentRequest


class _Noted(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    owner: _Owner
    text: str


class _NewReference(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    r: float


class RigRoutes:
    """Routes of the live rig for one listening socket, which has its own token."""

    def __init__(self, feed: Feed, driver: CommandSender, stream: Stream) -> None:
        """Prepare routes with the feed, the driver and the stream of the socket."""
        self._feed, self._driver, self._stream = feed, driver, stream
        # A stop has its own threads, so that it waits for no other request.
        self._stopping = ThreadPoolExecutor(4, thread_name_prefix="stop")

    def watching(self, connections: Connections) -> list[Route]:
        """Return the routes for clients that may only watch and stop."""

        async def stream(request: Request) -> Response:
            client = request.client
            address = (client.host, client.port) if client else ("", 0)
            viewer = Viewer(lambda: connections.abort(address))
            try:
                messages = self._stream.messages(viewer)
                first = await anext(messages)
            except TooManyViewersError as err:
                return error(503, str(err))
            return StreamingResponse(_after(first, messages), media_type="text/event-stream")

        async def stop(request: Request) -> Response:
            return await self._stop(request, by="" if self._stream.may_command else _VISITOR)

        return [
            *(Route(path, _page_file(name)) for path, name in PAGE_FILES.items()),
            Route("/api/stream", stream),
            Route("/api/stop", stop, methods=["POST"]),
        ]

    def commanding(self) -> list[Route]:
        """Return the routes for clients that may command."""
        return [
            Route("/api/run", self._run, methods=["POST"]),
            *(
                Route(f"/api/{name}", answered(does), methods=["POST"])
                for name, does in (
                    ("arm", self._arm),
                    ("release", lambda _: {"released": self._driver.release()}),
                    ("reset", lambda _: {"was_latched": self._driver.reset()}),
                    ("note", self._note),
                    ("reference", self._set_reference),
                    ("preview", self._preview),
                    ("laws", self._laws),
                )
            ),
        ]

    async def _stop(self, request: Request, *, by: str) -> Response:
        try:
            asked = msgspec.json.decode(await request.body() or b"{}", type=_Stopped)
        except (msgspec.DecodeError, UnicodeDecodeError):
            asked = _Stopped()  # a stop with an invalid name is accepted, too
        loop = asyncio.get_running_loop()
        try:
            await loop.run_in_executor(self._stopping, self._driver.stop, by or asked.owner)
        except RigError as err:
            return error(502, self._feed.trouble or str(err))
        return value({"stopped": True})

    def _arm(self, body: bytes) -> Any:
        asked = msgspec.json.decode(body, type=_Armed)
        self._driver.arm(asked.owner, asked.Ts)
        return {"armed": True}

    def _note(self, body: bytes) -> Any:
        asked = msgspec.json.decode(body, type=_Noted)
        return {"recorded": self._driver.note(asked.text, asked.owner)}

    def _set_reference(self, body: bytes) -> Any:
        self._driver.set_reference(msgspec.json.decode(body, type=_NewReference).r)
        return {"sent": True}

    def _preview(self, body: bytes) -> Any:
        asked = msgspec.json.decode(body, type=ExperimentRequest)
        if self._feed.status is None:
            raise RigError(self._feed.trouble)
        folder = self._folder_of(asked)
        return previewed(asked, self._feed.status, self._feed.description, folder)

    def _laws(self, _: bytes) -> Any:
        status, folder = self._feed.status, self._folder()
        if status is None:
            raise RigError(self._feed.trouble)
        try:
            rows = law_rows(folder, status)
        except OSError as err:
            raise FileError(f"{folder}: {err.strerror}") from err
        return {"folder": path_text(folder), "laws": rows, "word": UNMONITORED}

    def _folder(self) -> Path:
        status = self._feed.status
        return recordings_folder(status, status.rig if status else "1")

    def _folder_of(self, experiment: ExperimentRequest) -> Path | None:
        """Return the folder of an experiment's law; None for an experiment without a law."""
        return self._folder() if experiment.kind == "control" else None

    async def _run(self, request: Request) -> Response:
        asked_s = time.monotonic()  # read here: a start may wait for a thread, a stop does not

        def start(body: bytes) -> Any:
            asked = msgspec.json.decode(body, type=_OwnedExperiment)
            plan = plan_of(asked.experiment, asked.owner, self._folder_of(asked.experiment))
            self._driver.start(plan, asked_s=asked_s)
            return {"started": True}

        return await answered(start)(request)


def application(routes: list[Route]) -> Starlette:
    """Return the application with these routes; it reports each error as one line of JSON."""

    async def unknown(_: Request, err: Exception) -> Response:
        status = err.status_code if isinstance(err, HTTPException) else 404
        return error(status, "no such address" if status == 404 else str(err))

    async def internal(_: Request, err: Exception) -> Response:
        return error(500, f"internal error, please report it: {type(err).__name__}: {err}")

    handlers: Any = {404: unknown, 405: unknown, Exception: internal}
    return Starlette(routes=routes, exception_handlers=handlers)


def answered(does: Callable[[bytes], Any]) -> Answer:
    """Return an endpoint that calls `does` in a thread with the request's body, and sends JSON."""

    async def answer(request: Request) -> Response:
        body = await request.body()
        try:
            return value(await asyncio.to_thread(does, body))
        except ParameterError as err:
            return error(400, err.named(_LABELS.get(err.parameter, err.parameter)))
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, InputError) as err:
            return error(400, str(err))
        except BusyDriverError as err:
            return error(409, str(err))
        except RigError as err:
            return error(502, str(err))

    return answer


def value(found: Any) -> Response:
    """Return a response with a value as JSON."""
    return Response(page_json(found), media_type="application/json")


def error(status: int, why: str) -> Response:
    """Return a response with an error as a line of JSON."""
    body = page_json({"error": " ".join(why.split())})
    return Response(body, status, media_type="application/json")


def _page_file(name: str) -> Answer:
    async def answer(_: Request) -> Response:
        return Response((_PAGE / name).read_bytes(), media_type=_TYPES[name.rpartition(".")[2]])

    return answer


async def _after(first: bytes, messages: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    yield first
    async for message in messages:
        yield message


_FOUND = sorted(str(path.relative_to(_PAGE)) for path in _PAGE.rglob("*") if path.is_file())
PAGE_FILES = {"/" if name == "index.html" else f"/{name}": name for name in _FOUND}
"""Names of the page's files by path; the server delivers no other file."""
