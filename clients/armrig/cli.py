"""The command `armrig`: what a person types. Everything heavy is imported where it is needed."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

app = typer.Typer(
    help="Record, identify and validate models of a control laboratory's rig.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
collect_app = typer.Typer(
    help="Play an input, record what the rig does, and print the recording's path.",
    rich_markup_mode=None,
)
app.add_typer(collect_app, name="collect")

# Newer typers bring a click of their own, older ones use the click installed: this is either's.
_UsageError: Any = typer.BadParameter.__base__

RigId = Annotated[str, typer.Option("--rig", help="Id of the rig.")]
Connect = Annotated[
    str | None, typer.Option("--connect", metavar="ENDPOINT", help="zenoh endpoint of the daemon.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
File = Annotated[Path, typer.Argument(metavar="F", help="Recording (*.mcap).")]
SamplingTime = Annotated[
    float | None, typer.Option("--Ts", help="Sampling time in s; the daemon's by default.")
]
Seconds = Annotated[float, typer.Option("--seconds", min=0.1, help="Length.")]
Low = Annotated[float, typer.Option("--low", help="Lower level in V.")]
High = Annotated[float, typer.Option("--high", help="Upper level in V.")]
Owner = Annotated[str, typer.Option("--owner", help="Who takes the rig, for others to read.")]
Na = Annotated[int, typer.Option("--na", help="Number of a's (ARX).")]
Nb = Annotated[int, typer.Option("--nb", help="Number of b's.")]
Nf = Annotated[int, typer.Option("--nf", help="Number of f's (OE), the integrator's included.")]
Nk = Annotated[int, typer.Option("--nk", help="Samples before u reaches y.")]
Output = Annotated[
    Literal["theta_1", "alpha", "velocity"], typer.Option("--output", help="Which output.")
]
Structure = Literal["arx", "oe"]


@app.command()
def demo(
    directory: Annotated[Path, typer.Option(help="Where everything goes.")] = Path("demo"),
    seconds: Annotated[float, typer.Option(min=5, help="Length of each telegraph.")] = 30.0,
) -> None:
    """Emulate a rig, record it, identify it and write a report: two minutes, no hardware."""
    from armrig.demo import demo as run_demo

    run_demo(directory, seconds=seconds)


@app.command()
def status(rig: RigId = "1", connect: Connect = None, json: Json = False) -> None:
    """Say how the daemon and its rig are."""
    from armrig.rig import Rig
    from armrig.scheduling import scheduling

    with Rig(rig, connect=connect) as opened:
        report = opened.status()
    if json:
        _print_json(report)
        return
    last = report.last_run
    device = report.device
    _table(
        ("rig", f"{report.rig}, armrig {report.version}, at {report.endpoint}"),
        ("phase", f"{report.phase} {report.reason}".strip()),
        ("owner", report.owner or "nobody"),
        ("Ts", f"{report.Ts:g} s"),
        ("limits", f"{report.u_min:g} to {report.u_max:g} V"),
        ("device", ", ".join(f"{k} {v}" for k, v in device.items()) or "has not answered yet"),
        ("host", "; ".join(scheduling(report.host))),
        (
            "last run",
            "none"
            if last is None
            else f"{last.recording}, {last.samples} samples, "
            + (last.outcome if last.finished else "running"),
        ),
        ("recordings", report.recordings),
    )


@app.command()
def watch(
    rig: RigId = "1",
    connect: Connect = None,
    count: Annotated[int | None, typer.Option("--count", min=1, help="End after so many.")] = None,
    json: Json = False,
) -> None:
    """Show the live samples until Ctrl-C."""
    from itertools import islice

    from armrig.rig import Rig

    with Rig(rig, connect=connect) as opened:
        samples = islice(opened.stream("sample"), count)
        with suppress(KeyboardInterrupt):  # the way to end it
            if json:
                for sample in samples:
                    _print_json(sample._asdict())
            else:
                _watch(samples)


@app.command()
def stop(rig: RigId = "1", connect: Connect = None) -> None:
    """Bring the rig to 0 V, whoever has it."""
    from armrig.rig import Rig

    with Rig(rig, connect=connect) as opened:
        opened.stop()
    typer.echo(f"rig {rig} was told to stop; `armrig status` says how it is")


@app.command()
def reset(rig: RigId = "1", connect: Connect = None) -> None:
    """Leave a latched fault; the rig is then at 0 V and nobody's."""
    from armrig.rig import Rig

    with Rig(rig, connect=connect) as opened:
        opened.reset()
    typer.echo(f"rig {rig} was reset; `armrig status` says how it is")


@collect_app.command()
def blackbox(
    seconds: Seconds = 30.0,
    a: Annotated[float, typer.Option("--a", help="Probability of a switch at each sample.")] = 0.05,
    low: Low = 0.5,
    high: High = 4.5,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the random switches.")] = 1,
    Ts: SamplingTime = None,
    owner: Owner = "armrig collect",
    rig: RigId = "1",
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Play a random telegraph signal."""
    from armrig.excitation import telegraph

    telegraph(1, a, low, high)  # a level that is not allowed is told before a rig is asked for
    details = {"input": "telegraph", "a": a, "low": low, "high": high, "seed": seed}
    _collect(
        "blackbox",
        lambda N, _: telegraph(N, a, low, high, seed),
        *(details, seconds, Ts, owner, rig, connect),
        json=json,
    )


@collect_app.command()
def step(
    seconds: Seconds = 5.0,
    at: Annotated[float, typer.Option("--at", min=0, help="When it steps, in s.")] = 1.0,
    low: Low = 0.5,
    high: High = 4.5,
    Ts: SamplingTime = None,
    owner: Owner = "armrig collect",
    rig: RigId = "1",
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Play a step from the lower to the upper level."""
    from armrig.excitation import step as stepped

    stepped(1, low=low, high=high)
    details = {"input": "step", "low": low, "high": high, "at": at}
    _collect(
        "step",
        lambda N, Ts: stepped(N, low=low, high=high, at=round(at / Ts)),
        *(details, seconds, Ts, owner, rig, connect),
        json=json,
    )


@app.command()
def info(file: File, json: Json = False) -> None:
    """Say what a recording holds and how well it was sampled."""
    import numpy as np

    from armrig.jitter import sampling_statistics
    from armrig.recording import load

    rec = load(file)
    timing = sampling_statistics(rec)
    hidden = int(np.count_nonzero(rec.present & ~rec.valid))
    if json:
        facts = {"sha256": rec.sha256, "manifest": rec.manifest, "outcome": rec.outcome}
        facts |= {"samples": int(rec.samples.size), "missing": rec.missing, "invalid": hidden}
        facts |= {"truncated": rec.truncated, "damage": rec.damage, "sampling": timing}
        _print_json(facts | {"gaps": rec.gaps, "events": rec.events})
        return
    manifest = rec.manifest
    jitter, lateness = timing.jitter, timing.lateness
    details = ", ".join(f"{k} {v}" for k, v in manifest.details.items())
    _table(
        ("recording", str(rec.path)),
        ("sha256", rec.sha256),
        ("run", f"{manifest.run_id} of rig {manifest.rig}, {manifest.started}"),
        ("experiment", f"{manifest.experiment}: {details}" if details else manifest.experiment),
        (
            "samples",
            f"{rec.samples.size} at {rec.Ts:g} s, {rec.missing} missing, {hidden} without "
            "an angle (dead band)",
        ),
        ("outcome", rec.outcome.outcome if rec.outcome else "cut off"),
        ("jitter", f"p50 {jitter.p50:.0f}, p99 {jitter.p99:.0f}, max {jitter.max:.0f} µs"),
        ("lateness", f"p50 {lateness.p50:.1f}, p99 {lateness.p99:.1f}, max {lateness.max:.0f} µs"),
        *(("gap", f"{g.count} samples at {g.t:.3f} s, {g.reason}") for g in rec.gaps),
        *(("damage", rec.damage) for _ in range(rec.truncated)),
    )


@app.command()
def identify(
    file: File,
    structure: Annotated[Structure, typer.Option("--structure", help="Which model.")],
    na: Na = 4,
    nb: Nb = 4,
    nf: Nf = 4,
    nk: Nk = 1,
    integrator: Annotated[
        bool, typer.Option("--integrator", help="OE: one root of F is 1 exactly.")
    ] = False,
    validate: Annotated[
        Path | None, typer.Option("--validate", metavar="F2", help="Recording to validate with.")
    ] = None,
    output: Output = "theta_1",
    json: Json = False,
) -> None:
    """Estimate a model from a recording and say how sure it is."""
    from armrig.recording import load
    from armrig.validation import compare, residuals

    if integrator and structure == "arx":
        msg = "--integrator goes with --structure oe; an ARX model finds its own"
        raise typer.BadParameter(msg)
    data = _warned(load(file)).dataset(output)
    if structure == "arx":
        from armrig.estimation.arx import arx

        fit = arx(data, na=na, nb=nb, nk=nk)
    else:
        from armrig.estimation.oe import oe

        fit = oe(data, nb=nb, nf=nf, nk=nk, integrator=integrator)
    other = None if validate is None else _warned(load(validate)).dataset(output)
    judged = None if other is None else (compare(other, fit), residuals(fit, other))
    if not json:
        typer.echo(repr(fit))
        if judged is not None:
            typer.echo(f"validation on {validate}")
            typer.echo("\n".join(map(repr, judged)))
        return
    facts = _model_facts(fit) | {"recording": data.source}
    if other is not None and judged is not None:
        row, tests = judged[0][0], judged[1]
        facts["validation"] = {
            "recording": other.source,
            "fit_percent": row.fit_percent,
            "rms_error": row.rms_error,
            "velocity_fit_percent": row.velocity_fit_percent,
            "p_white": tests.whiteness,
            "p_no_dynamics_missing": tests.missing_dynamics,
            "p_no_feedback": tests.feedback,
        }
    _print_json(facts)


@app.command()
def compare(
    file: File,
    other: Annotated[Path, typer.Argument(metavar="F2", help="Recording to validate with.")],
    na: Na = 4,
    nb: Nb = 4,
    nf: Nf = 4,
    nk: Nk = 1,
    json: Json = False,
) -> None:
    """Identify ARX and OE from F, and compare them and the physics on F2, which they never saw."""
    from armrig.recording import load
    from armrig.study import Orders, study

    recordings = [_warned(load(f)) for f in (file, other)]
    done = study(recordings, orders=Orders(na=na, nb=nb, nf=nf, nk=nk))
    rows = [
        {
            "model": model.name,
            "fit_percent": row.fit_percent,
            "rms_error": row.rms_error,
            "velocity_fit_percent": row.velocity_fit_percent,
        }
        for model, row in zip(done.models, done.table.rows, strict=True)
    ]
    if json:
        _print_json({"validation": done.validation.source, "models": rows})
        return
    typer.echo(f"simulated on {other} (recording {done.validation.source[:12]})")
    for model, row in zip(done.models, done.table.rows, strict=True):
        velocity = row.velocity_fit_percent
        typer.echo(
            f"  {model.name:8} fit {row.fit_percent:7.2f} %  rms {row.rms_error:.4g} "
            f"{done.table.unit}"
            + (f"  velocity fit {velocity:7.2f} %" if velocity is not None else "")
        )


@app.command()
def report(
    files: Annotated[list[Path], typer.Argument(metavar="F…", help="Recordings (*.mcap).")],
    output: Annotated[Path, typer.Option("-o", "--output", help="PDF to write.")] = Path(
        "report.pdf"
    ),
    na: Na = 4,
    nb: Nb = 4,
    nf: Nf = 4,
    nk: Nk = 1,
) -> None:
    """Typeset a report: the first recording that is no step estimates, the next validates."""
    from armrig.recording import load
    from armrig.report import report as typeset
    from armrig.study import Orders, study

    recordings = [_warned(load(f)) for f in files]
    typeset(study(recordings, orders=Orders(na=na, nb=nb, nf=nf, nk=nk)), output)
    typer.echo(str(output))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0 only when it did what was asked."""
    command = typer.main.get_command(app)
    given = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    try:
        return int(command.main(given, prog_name="armrig", standalone_mode=False) or 0)
    except _UsageError as err:
        where = err.ctx.command_path if err.ctx else "armrig"
        return _failed(f"{err.format_message()}; see `{where} --help`", 2)
    except (typer.Abort, KeyboardInterrupt):
        return _failed("interrupted", 130)
    except BrokenPipeError:  # `armrig info F | head`
        with suppress(OSError):
            sys.stdout.close()
        return 1
    except OSError as err:
        named = f"{err.filename}: {err.strerror}" if err.filename and err.strerror else str(err)
        return _failed(named, 1)
    except (ValueError, RuntimeError) as err:
        return _failed(str(err), 1)


def _failed(message: str, code: int) -> int:
    print(f"armrig: {' '.join(message.split())}", file=sys.stderr)
    return code


def _warned(recording: Any) -> Any:
    if recording.truncated:
        print(f"armrig: {recording.path}: {recording.damage}", file=sys.stderr)
    return recording


def _print_json(value: Any) -> None:
    import msgspec

    typer.echo(msgspec.json.encode(value))


def _table(*rows: tuple[str, str]) -> None:
    width = max(len(name) for name, _ in rows)
    for name, value in rows:
        typer.echo(f"{name:{width}}  {value}")


def _model_facts(fit: Any) -> dict[str, Any]:
    rows = zip(fit.names, fit.theta, fit.std, fit.std_robust, strict=True)
    return {
        "structure": fit.structure,
        "orders": fit.orders,
        "integrator": fit.integrator,
        "Ts": fit.Ts,
        "parameters": {
            name: {"value": float(v), "std": float(s), "std_robust": float(r)}
            for name, v, s, r in rows
        },
        "noise_variance": fit.noise_variance,
        "loss": fit.loss,
        "fpe": fit.fpe,
        "aic": fit.aic,
        "mdl": fit.mdl,
        "fit_percent": fit.fit_percent,
        "p_white": fit.whiteness,
        "converged": fit.converged,
        "warnings": list(fit.warnings),
        "N": fit.N,
    }


def _watch(samples: Any) -> None:
    from math import degrees

    from rich.console import Console
    from rich.live import Live

    heading = f"{'k':>10} {'u [V]':>8} {'theta_1 [°]':>12} {'alpha [°]':>10} {'late [µs]':>10}"
    with Live(console=Console(), refresh_per_second=10) as live:
        for sample in samples:
            late = (sample.t_host_ns - sample.t_sched_ns) / 1e3
            live.update(
                f"{heading}\n{sample.k:>10} {sample.u_applied_v:>8.3f} "
                f"{degrees(sample.theta_1_rad):>12.2f} {degrees(sample.alpha_rad):>10.2f} "
                f"{late:>10.1f}"
            )


def _collect(
    experiment: str,
    make: Any,
    details: dict[str, Any],
    seconds: float,
    Ts: float | None,
    owner: str,
    rig: str,
    connect: str | None,
    *,
    json: bool,
) -> None:
    from armrig.progress import bar
    from armrig.rig import Rig

    with Rig(rig, connect=connect) as opened:
        granted = opened.arm(owner, Ts)
        u = make(round(seconds / granted.Ts), granted.Ts)
        with bar(experiment) as progress:
            path = opened.run(u, experiment=experiment, details=details, progress=progress)
    if json:
        _print_json({"recording": str(path), "samples": int(u.size), "Ts": granted.Ts})
    else:
        typer.echo(str(path))
