"""The command `armrig`: what a person types. Everything heavy is imported where it is needed."""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
collect_app = typer.Typer(
    help="Play an input, record what the rig does, and print the recording's path.",
    rich_markup_mode=None,
)
app.add_typer(collect_app, name="collect")

_MCAP = b"\x89MCAP0\r\n"
_LONGEST_DEMO_S = 600.0

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
Seconds = Annotated[
    float, typer.Option("--seconds", help="Length; at most 1 000 000 samples are played.")
]
Low = Annotated[float, typer.Option("--low", help="Lower level in V.")]
High = Annotated[float, typer.Option("--high", help="Upper level in V.")]
Pacing = Annotated[
    Literal["scheduled", "exchange"],
    typer.Option("--pacing", help="Who makes the samples: the device's timer, or the host."),
]
Owner = Annotated[str, typer.Option("--owner", help="Who takes the rig, for others to read.")]
Na = Annotated[int, typer.Option("--na", help="Number of a's (ARX).")]
Nb = Annotated[int, typer.Option("--nb", help="Number of b's.")]
Nf = Annotated[int, typer.Option("--nf", help="Number of f's (OE), the integrator's included.")]
Nk = Annotated[int, typer.Option("--nk", help="Samples before u reaches y.")]
# None says that the option was not given: what does not apply is refused, not ignored.
NaOrNone = Annotated[
    int | None, typer.Option("--na", help="Number of a's (ARX only).", show_default="4")
]
NfOrNone = Annotated[
    int | None,
    typer.Option(
        "--nf", help="Number of f's (OE only), the integrator's included.", show_default="4"
    ),
]
Output = Annotated[
    Literal["theta_1", "alpha", "velocity"], typer.Option("--output", help="Which output.")
]
Structure = Literal["arx", "oe"]


def _print_version(wanted: bool) -> None:
    if wanted:
        from armrig import __version__

        typer.echo(f"armrig {__version__}")
        raise typer.Exit


@app.callback(help="Record, identify and validate models of a control laboratory's rig.")
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", is_eager=True, callback=_print_version, help="Say the version, and exit."
        ),
    ] = False,
) -> None:
    """Take the options before the command."""


@app.command()
def demo(
    directory: Annotated[Path, typer.Option(help="Where everything goes.")] = Path("demo"),
    seconds: Annotated[float, typer.Option(min=5, help="Length of each telegraph.")] = 30.0,
) -> None:
    """Emulate a rig, record it, identify it and write a report: two minutes, no hardware."""
    from armrig.demo import demo as run_demo

    if directory.exists() and not directory.is_dir():
        msg = f"--directory {directory}: is a file; give a directory, which is made where none is"
        raise ValueError(msg)
    if not seconds <= _LONGEST_DEMO_S:  # NaN neither
        msg = f"--seconds {seconds:g}: 5 to {_LONGEST_DEMO_S:g} s"
        raise ValueError(msg)
    run_demo(directory, seconds=seconds)


@app.command()
def status(rig: RigId = "1", connect: Connect = None, json: Json = False) -> None:
    """Say how the daemon and its rig are."""
    from armrig.scheduling import scheduling

    with _opened(rig, connect) as opened:
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

    with _opened(rig, connect) as opened:
        samples = islice(opened.stream("sample"), count)
        with suppress(KeyboardInterrupt):  # the way to end it
            if json:
                for sample in samples:
                    _print_json(sample._asdict())
            elif sys.stdout.isatty():
                _watch(samples)
            else:
                _watch_in_lines(samples)


@app.command()
def stop(rig: RigId = "1", connect: Connect = None) -> None:
    """Bring the rig to 0 V, whoever has it."""
    with _opened(rig, connect) as opened:
        opened.stop()
    typer.echo(f"rig {rig} was told to stop; `armrig status` says how it is")


@app.command()
def reset(rig: RigId = "1", connect: Connect = None) -> None:
    """Leave a latched fault; the rig is then at 0 V and nobody's."""
    with _opened(rig, connect) as opened:
        opened.reset()
    typer.echo(f"rig {rig} was reset; `armrig status` says how it is")


@collect_app.command()
def blackbox(
    seconds: Seconds = 30.0,
    a: Annotated[float, typer.Option("--a", help="Probability of a switch at each sample.")] = 0.05,
    low: Low = 0.5,
    high: High = 4.5,
    seed: Annotated[
        int, typer.Option("--seed", min=0, max=2**53, help="Of the random switches.")
    ] = 1,
    Ts: SamplingTime = None,
    pacing: Pacing = "scheduled",
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
        *(details, seconds, Ts, pacing, owner, rig, connect),
        json=json,
    )


@collect_app.command()
def step(
    seconds: Seconds = 5.0,
    at: Annotated[float, typer.Option("--at", help="When it steps, in s.")] = 1.0,
    low: Low = 0.5,
    high: High = 4.5,
    Ts: SamplingTime = None,
    pacing: Pacing = "scheduled",
    owner: Owner = "armrig collect",
    rig: RigId = "1",
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Play a step from the lower to the upper level."""
    from armrig.excitation import step as stepped

    stepped(1, low=low, high=high)
    _check_step_time(at, seconds)
    details = {"input": "step", "low": low, "high": high, "at": at}
    _collect(
        "step",
        # A time just before the end may be nearest to the end, where it would be no step.
        lambda N, Ts: stepped(N, low=low, high=high, at=min(round(at / Ts), N - 1)),
        *(details, seconds, Ts, pacing, owner, rig, connect),
        json=json,
    )


@app.command()
def bench(
    seconds: Annotated[
        float, typer.Option("--seconds", help="For each contestant at each rate, over 4 rounds.")
    ] = 20.0,
    rates: Annotated[
        str, typer.Option("--rates", metavar="HZ,…", help="Sampling rates.")
    ] = "100,500,1000,2000",
    burn: Annotated[
        bool, typer.Option("--burn", help="Keep all processors busy beside everybody.")
    ] = False,
    json: Annotated[Path | None, typer.Option("--json", metavar="F", help="JSON to write.")] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="F", help="Figure to write.")
    ] = None,
) -> None:
    """Measure this host's timing against the limit: daemon, cyclictest, bare loop, bare zenoh.

    The exit code says that all was measured, not that the targets are met.
    """
    from rich.console import Console

    from armrig.bench.machine import machine
    from armrig.bench.tell import Result, check_figure, lines, write_figure
    from armrig.bench.turns import Plan, measure

    for file in (json, plot):  # not after minutes of measuring
        if file is not None:
            _check_output(file, [])
    if plot is not None:
        check_figure(plot)
    host = machine()
    plan = Plan(rates_hz=_rates(rates), seconds=seconds, burners=host.cpus if burn else 0)
    with Console(stderr=True).status("measuring") as status:
        result = Result(machine=host, plan=plan, rates=measure(plan, host, status.update))
    typer.echo("\n".join(lines(result)))
    if json is not None:
        import msgspec

        json.write_bytes(msgspec.json.format(msgspec.json.encode(result.facts())))
    if plot is not None:
        write_figure(result, plot)


@app.command()
def doctor(json: Json = False) -> None:
    """Say what on this host costs timing, and how to mend each; exit code 1 if anything does.

    What cannot be told or mended here is a note, and does not count.
    """
    from armrig import doctor as looks

    findings = looks.doctor()
    if json:
        _print_json(findings)
    else:
        typer.echo("\n".join(map(str, findings)))
    if not looks.is_well(findings):
        raise typer.Exit(1)


@app.command()
def info(
    file: File,
    json: Json = False,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="PNG", help="Figure of the timing to write.")
    ] = None,
) -> None:
    """Say what a recording holds and how well it was sampled."""
    from armrig.jitter import sampling_statistics
    from armrig.recording import load

    if plot is not None:
        _check_output(plot, [file])
    rec = load(file)
    if plot is not None:
        _plot_timing(rec, plot)
    timing = sampling_statistics(rec)
    if json:
        facts = {"sha256": rec.sha256, "manifest": rec.manifest, "outcome": rec.outcome}
        facts |= {"samples": int(rec.samples.size), "missing": rec.missing, "invalid": rec.hidden}
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
            f"{rec.samples.size} at {rec.Ts:g} s, {rec.missing} missing, {rec.hidden} without "
            "an angle (dead band, and the sample after)",
        ),
        ("paced by", "the device" if manifest.pacing == "scheduled" else "the host"),
        (
            "outcome",
            rec.outcome.outcome
            if rec.outcome
            else f"not known: the file {'is cut off before it' if rec.truncated else 'does not'} "
            + ("says" if rec.truncated else "say"),
        ),
        ("jitter", _microseconds(jitter, 0)),
        ("lateness", _microseconds(lateness, 1)),
        *(("gap", f"{g.count} samples at {g.t:.3f} s, {g.reason}") for g in rec.gaps),
        *(("damage", rec.damage) for _ in range(rec.truncated)),
    )


@app.command()
def identify(
    file: File,
    structure: Annotated[Structure, typer.Option("--structure", help="Which model.")],
    na: NaOrNone = None,
    nb: Nb = 4,
    nf: NfOrNone = None,
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
    from armrig import account
    from armrig.estimating import estimating, require_finite
    from armrig.estimation.orders import require_sensible
    from armrig.preprocess import INTEGRATING_OUTPUTS
    from armrig.recording import load
    from armrig.validation import compare, residuals

    _check_options_apply(structure, na=na, nf=nf, integrator=integrator)
    na, nf = 4 if na is None else na, 4 if nf is None else nf
    if integrator and output not in INTEGRATING_OUTPUTS:
        _tell(f"--integrator: {output} does not integrate, a root at 1 of F is not the rig's")
    data = _warned(load(file)).dataset(output)
    # Before the minutes that an estimation may take.
    other = None if validate is None else _warned(load(validate)).dataset(output)
    samples = data.N - data.missing
    if structure == "arx":
        from armrig.estimation.arx import arx

        require_sensible(samples=samples, nk=nk, na=na, nb=nb)
        with estimating("na and nb"):
            fit = arx(data, na=na, nb=nb, nk=nk)
            require_finite(fit, "na and nb")
    else:
        from armrig.estimation.oe import oe

        require_sensible(samples=samples, nk=nk, integrator=integrator, nb=nb, nf=nf)
        with estimating("nb and nf"):
            fit = oe(data, nb=nb, nf=nf, nk=nk, integrator=integrator)
            require_finite(fit, "nb and nf")
    judged = None
    if other is not None:
        with estimating("nb, and na or nf"):
            judged = compare(other, fit), residuals(fit, other)
        if judged[0][0].on_estimation_data:
            _tell(_SAME_DATA)
    if not json:
        typer.echo("\n".join(account.of_model(fit)))
        if judged is not None:
            typer.echo(f"validation on {validate}\n{judged[0]!r}")
            typer.echo("\n".join(account.of_tests(judged[1])))
        if hint := account.hint(fit):
            _tell(hint)
        return
    facts = _model_facts(fit) | {"recording": data.source}
    if other is not None and judged is not None:
        row, tests = judged[0][0], judged[1]
        facts["validation"] = {
            "recording": other.source,
            "on_estimation_data": row.on_estimation_data,
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
    from armrig.estimating import estimating
    from armrig.recording import load
    from armrig.study import Orders, study

    recordings = [_warned(load(f)) for f in (file, other)]
    with estimating("na, nb and nf"):
        done = study(recordings, orders=Orders(na=na, nb=nb, nf=nf, nk=nk))
    same = done.validation.digest == done.estimation.digest
    if same:
        _tell(_SAME_DATA)
    rows = [
        {
            "model": model.name,
            "fit_percent": row.fit_percent,
            "rms_error": row.rms_error,
            "velocity_fit_percent": row.velocity_fit_percent,
            "on_estimation_data": row.on_estimation_data,
        }
        for model, row in zip(done.models, done.table.rows, strict=True)
    ]
    if json:
        _print_json({"validation": done.validation.source, "models": rows})
        return
    where = str(done.recording_of(done.validation.source).path)
    where += ", its second half, the first one estimates" if done.halves else ""
    typer.echo(f"simulated on {where} (recording {done.validation.source[:12]})")
    for model, row in zip(done.models, done.table.rows, strict=True):
        velocity = row.velocity_fit_percent
        typer.echo(
            f"  {model.name:8} fit {row.fit_percent:7.2f} %  rms {row.rms_error:.4g} "
            f"{done.table.unit}"
            + (f"  velocity fit {velocity:7.2f} %" if velocity is not None else "")
            + ("  (estimation data)" if row.on_estimation_data else "")
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
    json: Json = False,
) -> None:
    """Typeset a report: the first recording that is no step estimates, the next validates."""
    _check_output(output, files, suffix=".pdf")
    from armrig.estimating import estimating, waiting
    from armrig.recording import load
    from armrig.report import report as typeset
    from armrig.study import Orders, study

    recordings = [_warned(load(f)) for f in files]
    with estimating("na, nb and nf"):
        done = study(recordings, orders=Orders(na=na, nb=nb, nf=nf, nk=nk))
    same = done.validation.digest == done.estimation.digest
    if same:
        _tell(_SAME_DATA)
    with waiting("typesetting"):
        typeset(done, output, remarks=[f"{_SAME_DATA[0].upper()}{_SAME_DATA[1:]}."] * same)
    if json:
        _print_json({"report": str(output), "recordings": [r.sha256 for r in recordings]})
    else:
        typer.echo(str(output))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0 only when it did what was asked.

    SIGTERM and SIGHUP (a closed terminal) end it as Ctrl-C does, which stops a rig that is running
    for us; the exit code is then 128 and the signal's number.
    """
    with _signals() as received:
        code = _run(arguments)
    if received:
        return _failed(f"ended by {received[0].name}", 128 + received[0])
    return code


@contextmanager
def _signals() -> Iterator[list[signal.Signals]]:
    """Raise KeyboardInterrupt at the first of SIGTERM and SIGHUP; give those that came."""
    received: list[signal.Signals] = []

    def interrupt(number: int, _: object) -> None:
        received.append(signal.Signals(number))
        # Only once: a second one, such as SIGHUP before SIGTERM, must not end the stopping.
        if len(received) == 1:
            raise KeyboardInterrupt

    # What nohup ignores stays ignored.
    before = {
        number: handler
        for number in (signal.SIGTERM, signal.SIGHUP)
        if (handler := signal.getsignal(number)) not in (None, signal.SIG_IGN)
    }
    for number in before:
        signal.signal(number, interrupt)
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _run(arguments: Sequence[str] | None) -> int:
    command = typer.main.get_command(app)
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        # Not command.main(): that has exit codes of its own for Ctrl-C and for a broken pipe.
        with command.make_context("armrig", [*given] or ["--help"]) as context:
            command.invoke(context)
    except typer.Exit as err:
        return int(err.exit_code) if given else 2  # nothing was asked for: help, as armrigd does
    except _UsageError as err:
        where = err.ctx.command_path if err.ctx else "armrig"
        return _failed(f"{_plainly(err.format_message())}; see `{where} --help`", 2)
    except (typer.Abort, KeyboardInterrupt) as err:
        return _failed(str(err) or "interrupted", 130)
    except BrokenPipeError:  # `armrig info F | head`
        # Nobody reads: what is still buffered must not complain when the interpreter ends.
        with suppress(OSError, ValueError), Path(os.devnull).open("wb") as nothing:
            os.dup2(nothing.fileno(), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except OSError as err:
        named = f"{err.filename}: {err.strerror}" if err.filename and err.strerror else str(err)
        return _failed(named, 1)
    except (ValueError, RuntimeError) as err:
        return _failed(str(err), 1)
    return 0


def _failed(message: str, code: int) -> int:
    _tell(message)
    return code


def _tell(message: str) -> None:
    with suppress(OSError):  # the terminal may be closed
        print(f"armrig: {' '.join(message.split())}", file=sys.stderr)


def _plainly(message: str) -> str:
    """Return what typer and its checks say in our words: option first, then what is allowed."""
    message = message.strip().rstrip(".")
    for theirs, ours in (
        (r"^Invalid value for '?([^']+?)'?: ", r"\1: "),
        (r"^Invalid value: ", ""),
        (r"Value error, ", ""),
        (r"Input should be ", "must be "),
        (r"must be a valid (integer|number),? .*$", r"must be a \1"),
        (r"must be a integer", "must be an integer"),
    ):
        message = re.sub(theirs, ours, message)
    return message


_SAME_DATA = (
    "the models are judged on the very data that they were estimated from, which flatters them: "
    "validate on another recording"
)


def _warned(recording: Any) -> Any:
    if recording.truncated:
        _tell(f"{recording.path}: {recording.damage}")
    return recording


@contextmanager
def _opened(rig: str, connect: str | None) -> Iterator[Any]:
    """Give the rig; what its daemon refuses is told with the command that helps."""
    from armrig.collection import with_commands
    from armrig.rig import RefusedError, Rig

    with Rig(rig, connect=connect) as opened:
        try:
            yield opened
        except RefusedError as err:
            raise RefusedError(with_commands(str(err), rig, connect)) from err


def _check_output(path: Path, inputs: Sequence[Path], suffix: str = "") -> None:
    """Refuse, before any work, what cannot or must not be written: a recording is never lost."""
    name = f"-o {path}" if suffix else str(path)
    if path.is_dir():
        example = path / ("report.pdf" if suffix else "timing.png")
        msg = f"{name}: is a directory; give a file, such as {example}"
        raise ValueError(msg)
    if path.exists() and any(f.exists() and path.samefile(f) for f in inputs):
        msg = f"{name}: is one of the recordings to read, which would be lost; give another name"
        raise ValueError(msg)
    if path.is_file():
        with path.open("rb") as file:
            if file.read(len(_MCAP)) == _MCAP:
                msg = f"{name}: is a recording, which would be lost; give another name"
                raise ValueError(msg)
    if suffix and path.suffix.lower() != suffix:
        msg = f"{name}: a report is a PDF; give a name that ends in {suffix}"
        raise ValueError(msg)
    if not path.absolute().parent.is_dir():
        msg = f"{name}: there is no directory {path.parent}; make it first"
        raise ValueError(msg)


def _check_options_apply(
    structure: str, *, na: int | None, nf: int | None, integrator: bool
) -> None:
    """Refuse options of the other structure, which would be without effect."""
    if structure == "arx" and integrator:
        msg = "--integrator goes with --structure oe; an ARX model finds its own"
        raise typer.BadParameter(msg)
    if structure == "arx" and nf is not None:
        msg = f"--nf {nf} goes with --structure oe; an ARX model has na and nb"
        raise typer.BadParameter(msg)
    if structure == "oe" and na is not None:
        msg = f"--na {na} goes with --structure arx; an OE model has nb and nf"
        raise typer.BadParameter(msg)


def _check_step_time(at: float, seconds: float) -> None:
    if not at >= 0:  # NaN neither
        msg = f"--at {at:g}: must be a number of seconds, 0 or more"
        raise ValueError(msg)
    if at >= seconds:
        where = "at" if at == seconds else "after"
        msg = f"--at {at:g} s is {where} the end, {seconds:g} s; give an earlier --at or more "
        msg += "--seconds"
        raise ValueError(msg)


def _microseconds(spread: Any, decimals: int) -> str:
    if spread.n == 0:
        return "too few samples"
    parts = (("p50", spread.p50, decimals), ("p99", spread.p99, decimals), ("max", spread.max, 0))
    return ", ".join(f"{name} {value:.{places}f}" for name, value, places in parts) + " µs"


def _rates(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(rate) for rate in text.split(","))
    except ValueError as err:
        msg = f"--rates {text!r}: whole numbers of Hz with commas are wanted, such as 100,1000"
        raise typer.BadParameter(msg) from err


def _plot_timing(recording: Any, path: Path) -> None:
    from matplotlib.figure import Figure

    from armrig.plots import plot_timing

    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    plot_timing(recording, quantity="jitter", ax=left)
    plot_timing(recording, quantity="lateness", ax=right)
    figure.savefig(path, dpi=150)


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


_WATCH_HEADING = f"{'k':>10} {'u [V]':>8} {'theta_1 [°]':>12} {'alpha [°]':>10} {'late [µs]':>10}"


def _watch(samples: Any) -> None:
    from rich.console import Console
    from rich.live import Live

    with Live(console=Console(), refresh_per_second=10) as live:
        for sample in samples:
            live.update(f"{_WATCH_HEADING}\n{_in_a_line(sample)}")


def _watch_in_lines(samples: Any) -> None:
    """Print a line for each sample, at once: a program reads them."""
    typer.echo(_WATCH_HEADING)
    for sample in samples:
        typer.echo(_in_a_line(sample))


def _in_a_line(sample: Any) -> str:
    from math import degrees

    late = (sample.t_host_ns - sample.t_sched_ns) / 1e3
    return (
        f"{sample.k:>10} {sample.u_applied_v:>8.3f} {degrees(sample.theta_1_rad):>12.2f} "
        f"{degrees(sample.alpha_rad):>10.2f} {late:>10.1f}"
    )


def _collect(
    experiment: str,
    make: Any,
    details: dict[str, Any],
    seconds: float,
    Ts: float | None,
    pacing: Literal["scheduled", "exchange"],
    owner: str,
    rig: str,
    connect: str | None,
    *,
    json: bool,
) -> None:
    from armrig.collection import Plan, collect

    plan = Plan(
        experiment=experiment,
        make=make,
        details=details,
        seconds=seconds,
        Ts=Ts,
        pacing=pacing,
        owner=owner,
    )
    path, N, Ts = collect(plan, rig=rig, connect=connect, tell=_tell)
    if json:
        _print_json({"recording": str(path), "samples": N, "Ts": Ts})
    else:
        typer.echo(str(path))
