"""Results from one recording; the computation takes long and runs in a separate process."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from armrig_core.errors import InputError
from armrig_core.rig.channels import MAX_CHANNELS
from numpy.typing import NDArray

from armrig.dashboard.bins import Signal, columns_of, signals_of
from armrig.data.dataset import Dataset, Signals, Vector
from armrig.estimation.request import Request
from armrig.estimation.transfer_functions import process
from armrig.models.fit import Fit
from armrig.recordings.files.loading import load
from armrig.recordings.files.recording_summary import path_text
from armrig.recordings.recording import Recording
from armrig.recordings.usability import data_verdict
from armrig.report.recording_facts import run_facts
from armrig.validation.advice import advice, examine_fit_of
from armrig.validation.answer import answer
from armrig.validation.comparison import compare
from armrig.validation.residuals import residuals
from armrig.validation.structure_hints import structure_hints

_POINTS = 4000  # of a curve: four for each pixel, so that extremes keep their times
_FINE = 0.001  # least step of the converter that four decimals show
_MOST_GAPS = _MOST_NOTES = 100
_KEPT = 2  # number of recordings kept: the recording on the page, and its validation recording


def facts(path: Path) -> dict[str, Any]:
    """Return facts about a recording, the verdict on its data, and its complete curves."""
    recording = _loaded(path)
    verdict = data_verdict(recording)
    return {
        "file": path_text(Path(path.name)),
        "about": [
            *((name, text) for name, text in run_facts(recording).items() if text),
            ("SHA-256", recording.short_hash),
        ],
        "usable": verdict.usable,
        "summary": verdict.summary,
        "findings": [(f.level, f.about, f.text) for f in verdict.findings],
        "gaps": [
            [float(round(g.k_first - recording.k_first)) * recording.Ts, g.count, g.reason]
            for g in recording.gaps[:_MOST_GAPS]
        ],
        "notes": [(n.t, n.owner, n.text) for n in recording.notes[:_MOST_NOTES]],
        "more_notes": max(0, len(recording.notes) - _MOST_NOTES),
        "seconds": recording.N * recording.Ts,
        "signals": signals_of(recording.description),
        "arm": recording.description.arm,
        "curves": curves(path, None, None),
    }


def curves(path: Path, start: float | None, stop: float | None) -> dict[str, Any]:
    """Return points of each signal of the page between two times in s.

    If there is no sample between the two times, the function returns the next sample. If the
    recording ends before the two times, the function returns the last sample.
    """
    t, columns = _part(path, start, stop)
    return {signal.key: drawn(t, y) for signal, y in columns.items()}


def csv(path: Path, start: float | None, stop: float | None) -> bytes:
    """Return a CSV of all samples between two times in s, with the page's quantities and units."""
    t, columns = _part(path, start, stop)
    shown = {signal: y for signal, y in columns.items() if signal.kind != "rate"}
    row = ",".join(["{:.6f}", *("{:.4f}" if s.step > _FINE else "{:.9g}" for s in shown)])
    rows = zip(t.tolist(), *(y.tolist() for y in shown.values()), strict=True)
    names = (
        f"{s.key}{' counted' * (s.kind == 'turning')} [{s.unit.replace('°', 'deg')}]" for s in shown
    )
    # This process encodes up to 100 MB, so that the server's process is free for a stop.
    lines = (row.format(*one) for one in rows)
    return "\n".join([",".join(["t [s]", *names]), *lines, ""]).encode()


def _part(
    path: Path, start: float | None, stop: float | None
) -> tuple[Vector, dict[Signal, Vector]]:
    """Return t in s and the values of each signal; turns are counted."""
    recording = _loaded(path)
    first = 0 if start is None else int(np.searchsorted(recording.t, start))
    first = min(first, recording.N - 1)
    last = recording.N if stop is None else int(np.searchsorted(recording.t, stop, "right"))
    part = slice(first, max(last, first + 1))
    shown = signals_of(recording.description)
    found = np.full((recording.N, 3 + MAX_CHANNELS), np.nan)
    found[:, :3] = np.column_stack([np.arange(recording.N), recording.t, recording.u])
    for signal in shown:
        if signal.kind in ("value", "turning"):
            found[:, 3 + signal.channel] = recording[signal.key] * signal.scale
    columns = columns_of(found[:0], found, shown)[part]
    return found[part, 1], dict(zip(shown, columns.T, strict=True))


def identified(path: Path, validation: Path | None, output: str) -> dict[str, Any]:
    """Estimate an OE model with the orders that the data suggest, and validate the model.

    The outputs of a model of two outputs share one denominator. Without a recording for validation,
    the first half of the recording is for estimation and the second half for validation.

    Raises ValueError if the data determine no model; the message contains the reason.
    """
    recording = _loaded(path)
    data = _data(recording, output)
    if validation is None:
        estimation, other = data.split(2)
    else:
        estimation, other = data, _data(_loaded(validation), output)
    columns = estimation.signals()
    hints = {name: structure_hints(columns.dataset(name)) for name in columns.outputs}
    integrating = tuple(name for name, found in hints.items() if found.integrator)
    one = len(hints) == 1
    fit = Request(
        structure="oe",
        orders={order: max(getattr(h, order) for h in hints.values()) for order in ("nb", "nf")},
        nk=min(found.nk for found in hints.values()),
        integrator=bool(integrating) if one else integrating,
        # The outputs of the arm are 0 at rest; those of another rig have an offset.
        offset=not (integrating or recording.description.arm),
        stable=True,
        shared=None if one else True,
    ).estimated(estimation)
    in_s = _process(estimation, [found.process for found in hints.values()], fit.offset)
    table = compare(other, fit, *in_s)
    scales = {signal.key: signal.scale for signal in signals_of(recording.description)}
    tests = residuals(fit, other)
    return {
        "model": fit.label,
        "answer": answer(fit, compare(other, fit), tests, tuple(examine_fit_of(estimation, fit))),
        "simulated": {
            row.output: drawn(recording.t, row.y * scales.get(row.output, 1.0))
            for row in compare(data, fit)
        },
        "judged": "the second half of the recording" if validation is None else validation.name,
        "texts": [
            ("model", repr(fit)),
            *(("the same in time constants", repr(model)) for model in in_s),
            ("why these orders", _of_each({name: h.explain() for name, h in hints.items()})),
            ("comparison with validation data", repr(table)),
            ("residuals", repr(tests)),
            (
                "poles, zeros and characteristics",
                _of_each({name: str(fit[name].summary()) for name in fit.outputs}),
            ),
            ("advice", advice(fit).explain()),
        ],
        "figures": _figures(fit, table, tests),
    }


def _process(data: Dataset | Signals, forms: list[str], offset: bool) -> list[Fit]:
    """Return the process model of a single output, if the data suggest one and determine it."""
    with suppress(InputError):
        given = forms if len(forms) == 1 else []
        return [process(data, form, offset=offset) for form in given if form]
    return []


def _data(recording: Recording, output: str) -> Dataset | Signals:
    """Return the data of the outputs whose names are given with commas; default: the first."""
    names = output.split(",") if output else [recording.first]
    return recording.signals(names) if len(names) > 1 else recording.dataset(names[0])


def _of_each(texts: Mapping[str, str]) -> str:
    """Return the texts of all outputs; each of several texts begins with the name of its output."""
    if len(texts) == 1:
        return next(iter(texts.values()))
    return "\n".join(f"{name}:\n{text}" for name, text in texts.items())


def report(path: Path, validation: Path | None, output: str) -> bytes:
    """Return the report of a recording as a PDF, for models of `output`: see `armrig report`."""
    from armrig.report.document import report as typeset
    from armrig.report.study import study

    recordings = [_loaded(path), *([_loaded(validation)] if validation else [])]
    done = study(recordings, outputs=output.split(",") if output else ())
    with tempfile.TemporaryDirectory(prefix="armrig-") as folder:
        return typeset(done, Path(folder) / "report.pdf").read_bytes()


@lru_cache(maxsize=_KEPT)
def _loaded(path: Path) -> Recording:
    return load(path)


def drawn(
    t: NDArray[np.float64], y: NDArray[np.float64], decimals: int = 4
) -> list[list[float | None]]:
    """Return t, the least y and the largest y of each point to draw; y is None if it is missing."""
    n = -(-t.size // _POINTS)
    first = np.arange(0, t.size, n)
    y = np.where(np.isfinite(y), y, np.nan)
    least, largest = np.fmin.reduceat(y, first), np.fmax.reduceat(y, first)
    return [
        t[first].round(6).tolist(),
        [None if v != v else round(v, decimals) for v in least.tolist()],
        [None if v != v else round(v, decimals) for v in largest.tolist()],
    ]


def _figures(fit: Fit, table: Any, tests: Any) -> list[tuple[str, str]]:
    """Return the titles of the figures, and the figures as SVG."""
    from io import StringIO

    import matplotlib as mpl

    from armrig.models.figures import plot_bode, plot_fit, plot_poles_zeros
    from armrig.plots.layout import figure_of

    mpl.use("svg")
    made = []
    one = (fit.ny, fit.nu) == (1, 1)
    bode = (lambda: figure_of(plot_bode(fit))) if one else (lambda: plot_fit(fit))
    channels = [channel for _, _, channel in fit.channels()]
    names = None if one else list(fit.outputs)
    for title, draw in (
        ("Simulated against measured", table.plot),
        ("Frequency response with 95 % bands", bode),
        (
            "Poles and zeros with 95 % regions",
            lambda: figure_of(plot_poles_zeros(*channels, labels=names)),
        ),
        ("Residuals on these data", tests.plot),
    ):
        drawn = StringIO()
        with mpl.rc_context({"svg.hashsalt": "armrig"}):
            draw().savefig(drawn, format="svg", metadata={"Date": None})
        made.append((title, drawn.getvalue()))
    return made
