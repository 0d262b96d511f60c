"""The files of the page, as they are in the package."""

from __future__ import annotations

from importlib.resources import files
from typing import NamedTuple

_TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
    "LICENSE": "text/plain; charset=utf-8",
}
_NAMES = (
    "dashboard.css",
    "main.js",
    "stream.js",
    "live_plots.js",
    "live_keys.js",
    "live_saving.js",
    "live_signals.js",
    "time_axis.js",
    "picture.js",
    "arm.js",
    "replay.js",
    "compared.js",
    "rows.js",
    "chart.js",
    "status.js",
    "control.js",
    "recordings.js",
    "recording.js",
    "model.js",
    "elements.js",
    "note.js",
    "icon.svg",
    "vendor/uPlot.iife.min.js",
    "vendor/uPlot.min.css",
    "vendor/uPlot.LICENSE",
)


class PageFile(NamedTuple):
    """One of them."""

    name: str

    @property
    def media_type(self) -> str:
        """What it is, for a browser."""
        return _TYPES[self.name.rpartition(".")[2]]

    def read(self) -> bytes:
        """Return it."""
        return files("armrig.dashboard").joinpath("page", *self.name.split("/")).read_bytes()


PAGE_FILES = {"/": PageFile("index.html")} | {f"/{name}": PageFile(name) for name in _NAMES}
"""Each path that is served, and nothing else of the disk."""
