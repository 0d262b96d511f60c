"""Routes for models: their data, estimates, plots and files; a search can be cancelled."""

from __future__ import annotations

import asyncio
import multiprocessing
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import msgspec
from armrig_core.errors import ArmrigError, InputError
from msgspec import Meta
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from armrig.dashboard import workbench
from armrig.dashboard.app import Answer, error, value
from armrig.dashboard.model_data import SECOND_HALF, ModelData
from armrig.dashboard.model_plots import MOST_AHEAD, Kind, plot
from armrig.dashboard.model_search import NO_MEMORY, run_search
from armrig.dashboard.page_json import page_json
from armrig.dashboard.recording_routes import RecordingRoutes

_MOST_MODELS = 50  # in a plot or a report
_MOST_SEARCHES = 4  # at the same time
_HASH = re.compile("[0-9a-f]{12,64}")
_DIED = "the process for computations died: try again"


class _PageRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request of the page; each route uses some of the fields."""

    data: ModelData | None = None
    request: dict[str, Any] = {}
    requests: tuple[dict[str, Any], ...] = ()
    kind: Kind = "output"
    horizon: Annotated[int, Meta(ge=0, le=MOST_AHEAD)] = 0
    name: Annotated[str, Meta(min_length=1, max_length=100)] = "model"
    file: Annotated[str, Meta(max_length=300)] = ""
    """File of a saved model."""
    page: Annotated[str, Meta(max_length=100)] = ""
    """Text that distinguishes the searches of several pages."""

    @property
    def models(self) -> tuple[workbench.Wanted, ...]:
        """Requested models; their number is limited."""
        if not 0 < len(self.requests) <= _MOST_MODELS:
            raise InputError(f"{len(self.requests)} models: choose 1 to {_MOST_MODELS}")
        return tuple(map(workbench.decode_model_request, self.requests))


class ModelRoutes(RecordingRoutes):
    """Routes for models. A separate process estimates, and each search has its own process."""

    _searches: dict[str, multiprocessing.process.BaseProcess]

    def routes(self) -> list[Route]:
        """Return the routes for models."""
        self._searches = {}
        return [
            Route(f"/api/models/{name}", self._endpoint(does), methods=["POST"])
            for name, does in (
                ("data", self._data),
                ("hints", self._hints),
                ("estimate", self._estimate),
                ("search", self._search),
                ("cancel", self._cancel),
                ("plot", self._plot),
                ("save", self._save),
                ("open", self._open),
                ("report", self._report_of_models),
            )
        ]

    def end(self) -> None:
        """End the separate processes at once."""
        for process in self._searches.values():
            process.kill()
        super().end()

    async def _data(self, asked: _PageRequest) -> Response:
        return await self._of_data(workbench.data_facts, asked)

    async def _hints(self, asked: _PageRequest) -> Response:
        return await self._of_data(workbench.hint_requests, asked)

    async def _estimate(self, asked: _PageRequest) -> Response:
        return await self._of_data(
            workbench.row, asked, workbench.decode_model_request(asked.request)
        )

    async def _plot(self, asked: _PageRequest) -> Response:
        return await self._of_data(plot, asked, asked.models, asked.kind, asked.horizon)

    async def _save(self, asked: _PageRequest) -> Response:
        model = workbench.decode_model_request(asked.request)
        return await self._of_data(workbench.save, asked, model, asked.name)

    async def _open(self, asked: _PageRequest) -> Response:
        data = asked.data
        if data is None:
            data = await self._in_worker(workbench.data_of_model, self._folder(), asked.file)
        data = await self._complete(data)
        saved = workbench.SavedModel(file=asked.file)
        return await self._json(workbench.row_with_data, data, saved)

    async def _report_of_models(self, asked: _PageRequest) -> Response:
        data = await self._complete(asked.data)
        pdf = await self._in_worker(workbench.report, self._folder(), data, asked.models)
        return Response(pdf, media_type="application/pdf")

    async def _of_data(
        self, does: Callable[..., Any], asked: _PageRequest, *arguments: Any
    ) -> Response:
        data = await self._complete(asked.data)
        return await self._json(does, data, *arguments)

    async def _json(self, does: Callable[..., Any], *arguments: Any) -> Response:
        text = await self._in_worker(workbench.json_of, does, self._folder(), *arguments)
        return Response(text, media_type="application/json")

    async def _search(self, asked: _PageRequest) -> Response:
        data = await self._complete(asked.data)
        self._end_search(asked.page)
        if len(self._searches) >= _MOST_SEARCHES:
            return error(503, f"{_MOST_SEARCHES} searches are running: wait for one to end")
        lines = self._search_lines(asked.page, data)
        return StreamingResponse(lines, media_type="application/x-ndjson")

    async def _cancel(self, asked: _PageRequest) -> Response:
        self._end_search(asked.page)
        return value({})

    def _end_search(self, page: str) -> None:
        if process := self._searches.pop(page, None):
            process.kill()

    async def _search_lines(self, page: str, data: ModelData) -> AsyncIterator[bytes]:
        """Yield lines with the progress of a search, then its result; kill a search in vain."""
        context = multiprocessing.get_context("spawn")
        receiving, sending = context.Pipe(duplex=False)
        given = (sending, self._folder(), data)
        process = context.Process(target=run_search, args=given, daemon=True)
        last: dict[str, Any] = {}
        try:
            await asyncio.to_thread(process.start)
            sending.close()
            self._searches[page] = process
            with suppress(EOFError):
                while not {"requests", "error"} & {*last}:
                    last = await asyncio.to_thread(receiving.recv)
                    yield page_json(last) + b"\n"
            if not {"requests", "error"} & {*last}:
                ended = self._searches.get(page) is not process
                yield page_json({"error": "the search was cancelled" if ended else _DIED}) + b"\n"
        finally:
            if self._searches.get(page) is process:
                del self._searches[page]
            if process.pid is None:
                receiving.close()  # a process that starts later ends at its first message
            else:
                process.kill()

    async def _complete(self, data: ModelData | None) -> ModelData:
        """Return the data with the names of files of the folder; propose a validation recording."""
        if data is None:
            raise InputError("the request names no data")
        file = await self._file(data.file)
        validation = data.validation
        if validation is None:
            found = await asyncio.to_thread(self._validation_of, self._path(file))
            validation = found.name if found else SECOND_HALF
        elif validation != SECOND_HALF:
            validation = await self._file(validation)
        return msgspec.structs.replace(data, file=file, validation=validation)

    async def _file(self, name: str) -> str:
        """Return the name of a recording that the page names, or names by its hash."""
        folder: Path = self._folder()
        if _HASH.fullmatch(name):
            name = await asyncio.to_thread(workbench.name_of_hash, folder, name)
        return self._path(name).name

    def _endpoint(self, does: Callable[[_PageRequest], Awaitable[Response]]) -> Answer:
        async def answer(request: Request) -> Response:
            try:
                asked = msgspec.json.decode(await request.body() or b"{}", type=_PageRequest)
                return await does(asked)
            except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as err:
                return error(400, str(err))
            except (ArmrigError, OSError) as err:
                return error(400, str(err))
            except MemoryError:
                return error(500, NO_MEMORY)
            except BrokenProcessPool:
                self._worker = None
                return error(500, _DIED)

        return answer
