"""Search for models in a process of its own, which reports its progress."""

from __future__ import annotations

import os
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from time import monotonic
from typing import Any

import msgspec
from armrig_core.errors import ArmrigError
from armrig_core.telemetry.channels import INTEGRATING_OUTPUTS

from armrig.dashboard.model_data import ModelData, PreparedData, estimation_data, validation_data
from armrig.report.batch.workers import begin_worker
from armrig.validation.model_search import search
from armrig.validation.search_result import Scored, SearchResult

_MOST_SHOWN = 5  # models, as `armrig identify --search` shows
NO_MEMORY = "the memory is not enough for this: take fewer samples or lower orders"
_NICENESS = 10  # the live view and a stop come first


def run_search(sending: Connection, folder: Path, data: ModelData) -> None:
    """Search, and send the progress, then the requests of the best models or the error."""
    begin_worker()
    os.nice(_NICENESS)
    with suppress(BrokenPipeError):  # the page is gone
        try:
            found = _search(sending, folder, data)
        except MemoryError:
            sending.send({"error": NO_MEMORY})
        except (ArmrigError, OSError) as err:
            sending.send({"error": str(err)})
        else:
            sending.send({"requests": _requests(found), "said": found.explain()})


def _search(sending: Connection, folder: Path, data: ModelData) -> SearchResult:
    begun, estimation = monotonic(), estimation_data(folder, data)

    def report(done: int, total: int, _: str) -> None:
        left = (monotonic() - begun) / done * (total - done) if done else None
        sending.send({"done": done, "of": total, "seconds_left": left})

    other = validation_data(folder, data).columns
    shared: dict[str, Any] = {"open_loop": estimation.played, "progress": report}
    return search(estimation.columns, other, **shared, **_integrators(estimation))


def _integrators(data: PreparedData) -> dict[str, Any]:
    """Return the option of a search of several signals, as the command chooses it."""
    columns = data.columns.signals()
    if (columns.ny, columns.nu) == (1, 1):
        return {}
    return {"integrator": [x for x in columns.outputs if data.arm and x in INTEGRATING_OUTPUTS]}


def _requests(found: SearchResult) -> list[dict[str, Any]]:
    """Return the requests of the chosen model and of the best others."""
    others = [one for one in found.ranked if one is not found.chosen]
    chosen = [found.chosen, *others[: _MOST_SHOWN - 1]]
    return [msgspec.to_builtins(_request(one)) for one in chosen]


def _request(scored: Scored) -> msgspec.Struct:
    """Return the request that estimates a model of the search again, as the command prints it."""
    again = msgspec.structs.replace(
        scored.candidate.request, stable=False, focus=None, starts=None, replicates=None
    )
    return again.of_fit(scored.fit)
