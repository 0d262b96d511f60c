"""The commands that design a control law from a model, and check it: pid, place, lqg, check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import typer
from armrig_core.process.options import CommandGroup, argument, group, option, preset

from armrig.cli import recorded_data
from armrig.cli.printing import columns, fields_of, inform, say, say_answer, spinner
from armrig.cli.results import OutputOptions, check_output, check_plot, figure_path, output_group

if TYPE_CHECKING:
    from armrig_core.control.control_law import ControlLaw

    from armrig.control.law_check import LawCheck
    from armrig.models.fit import Fit

design = CommandGroup("Design a control law from a model, or check a law.", no_args_is_help=True)


@dataclass(frozen=True, kw_only=True)
class DesignOptions:
    """Options of every design."""

    rig_file: Path | None = preset(
        None,
        "Description of the rig (TOML), or a name of `armrig rigs`; needed for an input that is "
        "not in V.",
        "the arm for its outputs, otherwise 0 to 5 V",
        names="--rig-file TOML",
    )
    validate: Path | None = preset(
        None,
        "Data that the model was not estimated from; without them the law is in doubt.",
        names="--validate F",
        parser=recorded_data.recording_path,
    )
    signal: str | None = preset(
        None, "Output that follows r.", "the first output", names="--signal NAME"
    )
    rate: bool | None = preset(
        None,
        "The rate of an integrating output follows r, or the output itself (--no-rate).",
        "the rate of a turning output",
        names="--rate/--no-rate",
    )
    reference: str | None = preset(
        None,
        "Lowest and highest r of a run, such as 23,60.",
        "what the input's range reaches",
        names="--reference LOW,HIGH",
    )
    u0: float | None = preset(
        None, "Voltage of the operating point of a model of deviations, in V.", names="--u0 V"
    )
    y0: list[float] | None = preset(
        None, "Output at the operating point; repeat it for two outputs.", "0", names="--y0 Y"
    )
    Ts: float | None = preset(
        None,
        "Sampling time of the law for a model in s, in s.",
        "the model's",
        names="--Ts S",
    )
    draws: int = preset(500, "Number of draws of the model's parameters.", "500", min=0)
    overshoot: float | None = preset(
        None, "Requirement: largest overshoot of a step, in percent.", names="--overshoot PERCENT"
    )
    settling: float | None = preset(
        None, "Requirement: longest 5 % settling time of a step, in s.", names="--settling S"
    )

    def requirement(self) -> dict[str, float]:
        """Return the requirement on the step response, as the file of the law contains it."""
        from armrig.control.requirement import Requirement

        bounds = {"overshoot": self.overshoot, "settling": self.settling}
        return Requirement(**{name: x for name, x in bounds.items() if x is not None}).facts

    def of_model(self) -> dict[str, Any]:
        """Return the arguments that `check_law` has, too."""
        return {"rig": _rig(self.rig_file), "u0": self.u0, "y0": self.y0 or 0.0}

    def of_design(self) -> dict[str, Any]:
        """Return the arguments of a design other than the model."""
        return self.of_model() | {
            "output": self.signal,
            "rate": self.rate,
            "reference": _pair(self.reference),
            "Ts": self.Ts,
        }


Common = Annotated[DesignOptions, group(DesignOptions)]
Shown = Annotated[OutputOptions, output_group("json", "verbose")]
Figure = Annotated[
    Path | None,
    option(
        "--plot FIGURE",
        "Figure to write (root locus, Bode, Nyquist, steps); FOLDER/ gets a .png of each.",
        parser=figure_path,
    ),
]
Model = Annotated[Path, argument("MODEL", "Model file written by identify --save.")]
Law = Annotated[
    Path,
    typer.Option("-o", "--output", metavar="JSON", help="File of the law to write."),
]


def _rig(file: Path | None) -> Any:
    from armrig_core.rig.description import path_of, read_description

    return read_description(path_of(file)) if file else None


def _pair(text: str | None) -> tuple[float, float] | None:
    """Return two numbers of an option."""
    if text is None:
        return None
    try:
        low, high = map(float, text.split(","))
    except ValueError:
        raise typer.BadParameter(f"--reference {text}: give two numbers, such as 23,60") from None
    return low, high


def _complex(texts: list[str] | None, name: str) -> list[complex] | None:
    """Return poles as numbers; a complex pole brings its conjugate."""
    poles: list[complex] = []
    for text in texts or ():
        try:
            pole = complex(text.replace(" ", "").replace("i", "j"))
        except ValueError:
            raise typer.BadParameter(
                f"{name} {text}: give a pole in rad/s, such as -42 or -18+18j"
            ) from None
        poles += [pole, pole.conjugate()] if pole.imag else [pole]
    return poles or None


@design.add("design pid model.json --time-constant 40 -o law.json", "pid")
def pid(
    *,
    model: Model,
    output: Law = Path("law.json"),
    time_constant: float | None = preset(
        None,
        "Time constant of the closed loop, in s (lambda tuning).",
        "the largest integral gain at --ms",
    ),
    ms: float | None = preset(None, "Largest sensitivity Ms.", "1.6"),
    derivative: bool | None = preset(
        None,
        "A derivative part, or none (--no-derivative).",
        "with two poles or more",
        names="--derivative/--no-derivative",
    ),
    filter_time: float | None = preset(
        None, "Time constant of the filter of y, in s.", "a tenth of that of the loop"
    ),
    weight: float | None = preset(
        None, "Weight of r in the proportional part.", "1 with --time-constant, otherwise 0.5"
    ),
    common: Common,
    plot: Figure = None,
    out: Shown,
) -> None:
    """Design a PI or PID law: lambda tuning, or the largest integral gain at Ms of 1.6."""
    import armrig

    options = {"time_constant": time_constant, "ms": ms, "derivative": derivative}
    options |= {"filter_time": filter_time, "weight": weight}
    _design(armrig.control.pid, model, output, options, common, replace(out, plot=plot))


@design.add("design place model.json --pole=-18+18j --pole=-42 -o law.json", "place")
def place(
    *,
    model: Model,
    output: Law = Path("law.json"),
    pole: list[str] | None = preset(
        None,
        "Pole of the closed loop in s, in rad/s, such as --pole=-18+18j for a pair; repeatable.",
        names="--pole S",
    ),
    observer: list[str] | None = preset(
        None,
        "Pole of the observer in s, in rad/s; repeatable.",
        "a Kalman predictor",
        names="--observer S",
    ),
    common: Common,
    plot: Figure = None,
    out: Shown,
) -> None:
    """Design state feedback with given poles, and an observer of a disturbance in V."""
    import armrig

    poles = _complex(pole, "--pole")
    if not poles:
        raise typer.BadParameter("give the poles of the closed loop, such as --pole=-18+18j")
    options = {"poles": poles, "observer": _complex(observer, "--observer")}
    _design(armrig.control.place, model, output, options, common, replace(out, plot=plot))


@design.add("design lqg model.json --effort 0.1 -o law.json", "lqg")
def lqg(
    *,
    model: Model,
    output: Law = Path("law.json"),
    effort: float = preset(
        1.0, "Cost of 1 V² of the input against an error of 1 V; larger is slower."
    ),
    input_noise: float | None = preset(
        None, "Deviation of the input's noise, in V.", "2 % of its range"
    ),
    drift: float | None = preset(
        None,
        "Deviation of the disturbance's change in a sample, in V; larger integrates faster.",
        "0.2 % of the input's range",
    ),
    common: Common,
    plot: Figure = None,
    out: Shown,
) -> None:
    """Design a law of least quadratic cost, with a Kalman predictor."""
    import armrig

    options = {"effort": effort, "input_noise": input_noise, "drift": drift}
    _design(armrig.control.lqg, model, output, options, common, replace(out, plot=plot))


@design.add("design check law.json --model model.json", "check")
def check(
    *,
    law: Annotated[Path, argument("LAW", "Law file.")],
    model: Path | None = preset(
        None, "Model to judge the law on.", "that of the law's design", names="--model JSON"
    ),
    rig_file: Path | None = preset(
        None, "Description of the rig.", "that of the law's design", names="--rig-file TOML"
    ),
    validate: Path | None = preset(
        None,
        "Data that the model was not estimated from.",
        names="--validate F",
        parser=recorded_data.recording_path,
    ),
    draws: int = preset(500, "Number of draws of the model's parameters.", "500", min=0),
    plot: Figure = None,
    out: Shown,
) -> None:
    """Show margins and steps of a law over draws of its model, and margins on corners."""
    import armrig
    from armrig.control.loop_comparison import model_path

    check_plot(plot, [law])
    control_law = armrig.control.load_law(law)
    files = control_law.design.get("files")
    named = files.get("rig") if isinstance(files, dict) else None
    path = model or Path(model_path(control_law))
    rig = rig_file or (Path(str(named)) if named else None)
    fit = armrig.load_fit(path)
    judged = armrig.control.check_law(
        control_law, fit, draws=draws, rig=_rig(rig), validation=_data(validate, fit)
    )
    _show(judged, control_law, replace(out, plot=plot))


@design.add("design compare @run --plot loop.png", "compare")
def compare(
    *,
    file: recorded_data.File,
    model: Path | None = preset(
        None, "Model file.", "the model that the law names", names="--model MODEL"
    ),
    draws: int = preset(30, "Number of draws of the model's parameters.", "30", min=0),
    plot: Figure = None,
    out: Shown,
) -> None:
    """Show a recorded run in control next to its prediction by the model."""
    import armrig
    from armrig import plots
    from armrig.control.loop_comparison import model_path
    from armrig.recordings.files.control_run import control_run

    check_plot(plot, [file])
    recording = armrig.load(file)
    run = control_run(recording)
    path = model or (model_path(run.law) if run else None)
    if path:
        inform(f"the model is {path}", dim=True)
    with spinner("predicting"):
        comparison = armrig.control.compare_loop(
            recording, armrig.load_fit(path) if path else None, draws=draws
        )
    replace(out, plot=plot).show(
        facts=comparison.facts,
        say=lambda: say_answer(comparison.verdict),
        figures=lambda: {"loop": lambda *, ax: plots.plot_loop_comparison(comparison, ax=ax)},
    )


def _data(path: Path | None, fit: Fit) -> Any:
    """Return the validation data of a model, with the model's signals."""
    if path is None:
        return None
    part = recorded_data.SignalChoice()
    return part.of(path, fit)


def _design(
    method: Any,
    model: Path,
    output: Path,
    options: dict[str, Any],
    common: DesignOptions,
    out: OutputOptions,
) -> None:
    """Design a law, write its file, and print what it will do."""
    import armrig

    check_output(output, [model], "-o", "a law is a JSON file", ".json")
    check_plot(out.plot, [model])
    fit = armrig.load_fit(model)
    data = _data(common.validate, fit)
    requirement = common.requirement()
    files = {"model": str(model)} | ({"rig": str(common.rig_file)} if common.rig_file else {})
    facts = {"files": files} | ({"requirement": requirement} if requirement else {})
    with spinner("designing"):
        law: ControlLaw = method(fit, **options, **common.of_design(), validation=data)
        law = msgspec.structs.replace(law, design=law.design | facts)
        judged = armrig.control.check_law(
            law, fit, draws=common.draws, validation=data, **common.of_model()
        )
    _show(judged, law, out, output)


def _show(
    judged: LawCheck, law: ControlLaw, out: OutputOptions, output: Path | None = None
) -> None:
    from armrig import plots

    def facts() -> dict[str, Any]:
        bands = ("Ms", "gain", "phase_deg", "delay_s", "overshoot", "settling")
        names = "stable Ms gain least_gain phase_deg delay_s"
        fields: dict[str, Any] = {"law": str(output)} if output else {}
        fields |= {"verdict": judged.verdict, "worst_Ms": judged.worst_Ms}
        fields |= {"has_monitor": law.monitor is not None}
        fields |= {"unstable_share": judged.unstable_share, "doubts": judged.doubts}
        fields |= {"nominal": fields_of(judged.nominal, names)}
        fields |= {"bands": {name: judged.band(name) for name in bands}}
        corners = {name: fields_of(m, names) for name, m in judged.corners.items()}
        return fields | {"corners": corners, "sha256": law.sha256, "design": law.design}

    def say_check() -> None:
        from armrig.numerics.quantities import plural

        say_answer(judged.verdict)
        r, method = law.reference, law.design.get("method", "law")
        monitor = "no monitor (--unmonitored)"
        if law.monitor:
            monitor = f"monitor of {' and '.join(o.name for o in law.outputs)}"
        limits = f"{r.low:.4g} to {r.high:.4g} {r.unit}".rstrip()
        say(
            f"{method}, {plural(law.order, 'state')} at {judged.Ts:g} s; r is {r.name} from "
            f"{limits}, u from {law.lo:g} to {law.hi:g} V; {monitor}.",
            dim=True,
        )
        if out.verbose:
            rows = {"model": judged.nominal} | dict(judged.corners)
            table: list[Sequence[str]] = [("", "Ms", "gain", "phase [°]", "delay [s]")]
            for name, m in rows.items():
                values = (m.Ms, m.gain, m.phase_deg, m.delay_s)
                table.append((name, *(f"{x:.4g}" for x in values)))
            say(columns(table))
            for name, value in law.design.get("gains", {}).items():
                say(f"{name} {value:.5g}")

    def write() -> None:
        if output is not None:
            replaced = "; replaced" if output.exists() else ""
            output.write_bytes(law.text)
            inform(f"law: {output}{replaced}", dim=True)

    out.show(
        facts=facts,
        say=say_check,
        write=write,
        figures=lambda: {
            "root_locus": lambda *, ax: plots.plot_root_locus(judged, ax=ax),
            "bode": lambda *, ax: plots.plot_loop(judged, ax=ax),
            "nyquist": lambda *, ax: plots.plot_nyquist(judged, ax=ax),
            "steps": lambda *, ax: plots.plot_law_steps(judged, ax=ax),
        },
        columns=2,
        width=4.6,
    )
