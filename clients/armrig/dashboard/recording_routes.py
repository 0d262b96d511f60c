"""Routes for recordings: the list, a recording, its curves, its model and its report."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Annotated, Any

import msgspec
from armrig_core.errors import ArmrigError, FileError
from armrig_core.recording_file.file_records import MAGIC
from armrig_core.recording_file.opening import regular_file
from msgspec import Meta
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from armrig.dashboard.app import Answer, error, value
from armrig.dashboard.feed import Feed
from armrig.dashboard.laws import file_in, recordings_folder
from armrig.dashboard.study_of_one import csv, curves, facts, identified, report
from armrig.recordings.files.catalogue import Catalogue, catalogue, facts_of
from armrig.recordings.files.recording_names import Answering, answering_among, short_name
from armrig.recordings.files.recording_summary import RecordingSummary, path_text
from armrig.report.batch.workers import begin_worker

_MOST_LISTED = 200
_PIECE = 1 << 18  # B
_Seconds = Annotated[float, Meta(ge=0, le=1e7)]


class _RecordingQuery(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request that concerns a recording."""

    file: Annotated[str, Meta(max_length=300)]
    start: _Seconds | None = None
    stop: _Seconds | None = None
    output: Annotated[str, Meta(max_length=100)] = ""
    """Outputs of a model, with commas; default: the first channel."""


class RecordingRoutes:
    """Routes for recordings; slow requests run one after another in a separate process."""

    def __init__(self, feed: Feed, rig: str) -> None:
        """Prepare routes for the daemon's folder; if it is unreadable, for that of `armrig ls`."""
        self._feed, self._rig = feed, rig
        self._worker: ProcessPoolExecutor | None = None

    def routes(self) -> list[Route]:
        """Return the routes for recordings."""
        return [
            Route("/api/recordings", self._listed, methods=["POST"]),
            *(
                Route(f"/api/{name}", self._answered(does), methods=["POST"])
                for name, does in (
                    ("recording", self._facts),
                    ("curves", self._curves),
                    ("csv", self._csv),
                    ("mcap", self._mcap),
                    ("identify", self._identified),
                    ("report", self._report),
                )
            ),
        ]

    def end(self) -> None:
        """End the separate process at once."""
        if self._worker is not None:
            children = multiprocessing.active_children()
            self._worker.shutdown(wait=False, cancel_futures=True)
            for child in children:
                child.terminate()

    async def _listed(self, _: Request) -> Response:
        try:
            found = await asyncio.to_thread(catalogue, self._folder())
        except OSError as err:
            return error(404, f"{self._folder()}: {err.strerror}; record an experiment first")
        answering = answering_among(found.recordings)
        return value(
            {
                "folder": path_text(found.folder),
                "count": len(found),
                "recordings": [
                    {
                        **facts_of(s),
                        "file": path_text(Path(s.file)),
                        "at": _name_or_file(s, answering),
                    }
                    for s in found.recordings[:_MOST_LISTED]
                ],
                "left_out": [
                    f"{'' if left.is_foreign else 'damaged: '}{path_text(Path(left.path.name))}: "
                    f"{left.why}"
                    for left in found.left_out
                ],
            }
        )

    async def _facts(self, path: Path, _: _RecordingQuery) -> Response:
        return value(await self._in_worker(facts, path))

    async def _curves(self, path: Path, asked: _RecordingQuery) -> Response:
        return value(await self._in_worker(curves, path, asked.start, asked.stop))

    async def _csv(self, path: Path, asked: _RecordingQuery) -> Response:
        text = await self._in_worker(csv, path, asked.start, asked.stop)
        return Response(text, media_type="text/csv")

    async def _mcap(self, path: Path, _: _RecordingQuery) -> Response:
        size, pieces = await asyncio.to_thread(whole_file, path)
        headers = {"content-length": str(size)}
        return StreamingResponse(pieces, media_type="application/octet-stream", headers=headers)

    async def _identified(self, path: Path, asked: _RecordingQuery) -> Response:
        validation = await asyncio.to_thread(self._validation_of, path)
        return value(await self._in_worker(identified, path, validation, asked.output))

    async def _report(self, path: Path, asked: _RecordingQuery) -> Response:
        validation = await asyncio.to_thread(self._validation_of, path)
        pdf = await self._in_worker(report, path, validation, asked.output)
        return Response(pdf, media_type="application/pdf")

    def _answered(self, does: Callable[[Path, _RecordingQuery], Any]) -> Answer:
        async def answer(request: Request) -> Response:
            try:
                asked = msgspec.json.decode(await request.body(), type=_RecordingQuery)
                response: Response = await does(self._path(asked.file), asked)
            except (msgspec.DecodeError, UnicodeDecodeError, OSError, ArmrigError) as err:
                return error(400, str(err))
            except BrokenProcessPool:
                self._worker = None
                return error(500, "the process for computations died: try again")
            return response

        return answer

    def _folder(self) -> Path:
        return recordings_folder(self._feed.status, self._rig)

    def _path(self, file: str) -> Path:
        """Return the path of the recording with this file name; refuse any other file."""
        return file_in(self._folder(), file, ".mcap")

    def _validation_of(self, path: Path) -> Path | None:
        """Return the path of a recording's validation recording; None if there is none."""
        found: Catalogue = catalogue(path.parent)
        of = next((s for s in found.recordings if s.file == path.name), None)
        if of is None:
            return None
        return next((s.path for s in found.recordings if s.validation_of == of.run_id), None)

    async def _in_worker(self, does: Callable[..., Any], *arguments: Any) -> Any:
        if self._worker is None:
            # Spawned: a fork would keep the locks of other threads forever.
            context = multiprocessing.get_context("spawn")
            self._worker = ProcessPoolExecutor(1, mp_context=context, initializer=begin_worker)
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._worker, does, *arguments)


def whole_file(path: Path) -> tuple[int, Iterator[bytes]]:
    """Return the size of a recording and an iterator over its bytes; refuse a link.

    Raises OSError or DamageError if the file cannot be read, is a link, or is not a regular file.
    Raises FileError if the file is not a recording.
    """
    file = regular_file(path, may_be_link=False)
    size = os.fstat(file.fileno()).st_size
    if file.read(len(MAGIC)) != MAGIC:
        file.close()
        raise FileError(f"{path.name}: not an MCAP file")

    def pieces() -> Iterator[bytes]:
        with file:
            file.seek(0)
            left = size  # if the file grows, only the reported size is sent
            while piece := file.read(min(left, _PIECE)):
                left -= len(piece)
                yield piece

    return size, pieces()


def _name_or_file(summary: RecordingSummary, answering: Answering) -> str:
    """Return the @name that the commands accept for a recording; without one, its file name."""
    name = short_name(summary, answering)
    return name if name.startswith("@") else path_text(Path(summary.file))
