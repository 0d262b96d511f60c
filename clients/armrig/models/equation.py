"""Texts about a model: equation (also as LaTeX, Typst and HTML), tables, quality; JSON fields."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from math import isfinite, isnan
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from armrig.data.step import BIASED, Step, with_notes
from armrig.models.estimate import Estimate, PastProjection
from armrig.models.structure_table import row_of
from armrig.models.transfer_function import TransferFunction
from armrig.numerics.confidence_regions import Band
from armrig.numerics.quantities import NBSP, digits, join_names, near_one, places, plural, with_std

if TYPE_CHECKING:
    from armrig.models.fit import Fit
    from armrig.models.responses import Roots
    from armrig.models.uncertainty import Draws

_MAX_DECIMALS = 9
_MIN_FIT_PERCENT = 5.0  # a lower fit explains less than a tenth of the variance


def description(fit: Fit) -> str:
    """Return a model as a few lines of text.

    The text of a model of several signals has a line for each output instead of the equation.
    """
    if (fit.ny, fit.nu) != (1, 1):
        lines = list(outputs_and_poles(fit))
    else:
        lines = [heading(fit), *equations(fit, with_std=bool(fit.quality))]
        lines += [
            f"  fit {q.fit_percent:.2f} % one step ahead on estimation data, "
            f"loss {q.loss:.4g}, FPE {fit.fpe:.4g}, AIC {fit.aic:.5g}\n"
            f"  {whiteness_sentence(fit)}"
            for q in fit.quality
        ]
        lines += _starts_lines(fit)
    notes = [Step(f.text, BIASED if f.remedy == "noise" else "") for f in fit.findings]
    return with_notes(lines, notes, "warning")


def _starts_lines(fit: Fit, squared_unit: str = "") -> Iterator[str]:
    """Yield a line with the losses of a search from several starts."""
    if fit.search.starts:
        how = "agree" if fit.search.agreed else "DISAGREE, the best one was used"
        ends = ", ".join(f"{s.name} {s.loss:.6g}" for s in fit.search.starts)
        unfinished = "" if fit.search.converged else " (NOT CONVERGED)"
        yield f"  starts {how}: {ends}{squared_unit}{unfinished}"


def outputs_and_poles(fit: Fit) -> Iterator[str]:
    """Yield a line with the signals, a line for each output, and a line with the poles."""
    inputs = ", ".join(_with_unit(*x) for x in zip(fit.inputs, fit.input_units, strict=True))
    yield (
        f"{fit.label}: {inputs} to {plural(fit.ny, 'output')}, Ts {fit.Ts:g} s, "
        f"{plural(fit.theta.size, 'parameter')}"
    )
    outputs = [_with_unit(*x) for x in zip(fit.outputs, fit.units, strict=True)]
    width = max(map(len, outputs))
    for output, q in zip(outputs, fit.quality, strict=True):
        yield (
            f"  {output:{width}}  fit {q.fit_percent:6.2f} % one step ahead, loss {q.loss:.4g}, "
            f"N {q.N}, residuals {q.white}"
        )
    if fit.ny > 1:
        yield f"  correlation of the noise: {_correlations(fit)}"
    poles = fit.poles()
    parts = zip(poles.values, np.asarray(poles.std), strict=True)
    yield "  poles: " + ", ".join(_pole(z, std) for z, std in parts if z.imag >= 0)
    if fit.search.starts and not fit.search.converged:
        yield "  NOT CONVERGED"


def _correlations(fit: Fit) -> str:
    std = np.sqrt(np.diag(fit.noise_covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        r = fit.noise_covariance / np.outer(std, std)
    return ", ".join(
        f"{fit.outputs[i]} and {fit.outputs[k]} {r[i, k]:.2f}"
        for i in range(fit.ny)
        for k in range(i + 1, fit.ny)
    )


def _pole(z: complex, std: float) -> str:
    sign = f" ± {z.imag:.4f}i" if z.imag > 0 else ""
    return f"{z.real:.4f}{sign} (std {digits(std, 2)})"


def heading(model: Fit) -> str:
    """Return a line with structure, orders, signals, Ts and, for an estimate, number of samples."""
    return f"{model.heading}: {signals(model)}"


def signals(model: Fit) -> str:
    """Return a line with signals, sampling time and, for an estimate, number of samples."""
    used = f", N {model.N}" if model.quality else ""
    return f"{input_and_output(model)}{used}"


def input_and_output(model: Fit) -> str:
    """Return a line with the signals and the sampling time."""
    u, y = (
        join_names([_with_unit(name, unit) for name, unit in zip(names, units, strict=True)])
        for names, units in ((model.inputs, model.input_units), (model.outputs, model.units))
    )
    if isinstance(model.form, TransferFunction):
        return f"{u} to {y}, continuous time, from Ts {model.form.Ts:g} s"
    return f"{u} to {y}, Ts {model.Ts:g} s"


def equations(model: Fit, *, with_std: bool = False) -> list[str]:
    """Return lines with the equation and the polynomials."""
    notation = _PLAIN if with_std else _PLAIN._replace(term="{value}{power}")
    lines = [f"  {form(model)}", *(f"  {x}" for x in _definitions(model, notation, "="))]
    if model.Ts == 0:
        if model.integrator:
            lines.append("  F has the factor s by construction")
        lines += [f"  {line}" for line in repr(model.quantities()).splitlines()]
    elif model.integrator:
        lines.append(f"  {model.integrating.upper()} has the factor 1 - q^-1 by construction")
    return lines


def form(model: Fit) -> str:
    """Return the model's equation with the letters of its polynomials."""
    model_letters = letters(model)
    of_q = {letter: f"{letter}({_variable(model, letter)})" for letter in "ABCDF"}
    left = "A(q) y(t)" if "A" in model_letters else "y(t)"
    driven = f"{of_q['B']}/{of_q['F']}" if "F" in model_letters else "B(q)"
    noise = {
        (False, False): "e(t)",
        (True, False): "C(q) e(t)",
        (False, True): "1/D(q) e(t)",
        (True, True): "C(q)/D(q) e(t)",
    }["C" in model_letters, "D" in model_letters]
    if row_of(model.structure).free_noise:
        noise = "v(t)"
    delayed = isinstance(model.form, TransferFunction) and model.form.delay > 0
    return f"{left} = {driven} u(t{' - delay' * delayed}) + {noise}"


def _variable(model: Fit, letter: str) -> str:
    """Return s for B and F of a model in continuous time, otherwise q."""
    return "s" if model.Ts == 0 and letter in "BF" else "q"


def letters(model: Fit) -> list[str]:
    """Return the letters of B and of the polynomials that are not 1, "A" … "F"."""
    return [name for name in "ABCDF" if name == "B" or model.polynomial(name.lower()).size > 1]


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def explains_nothing(fit: Fit) -> bool:
    """Return whether the model fits each output of its estimation data to less than 5 %."""
    return all(q.fit_percent < _MIN_FIT_PERCENT for q in fit.quality)


def whiteness_sentence(fit: Fit, std: str = "std", robust: str = "std_robust") -> str:
    """Return a text with the results of the whiteness tests and the standard deviation to trust.

    The text of several outputs names those with coloured residuals. If the model explains hardly
    anything, the residuals are nearly y itself, and the text says so instead.
    """
    whites = [q.white for q in fit.quality]
    coloured = [name for name, q in zip(fit.outputs, fit.quality, strict=True) if q.white.coloured]
    if fit.ny == 1:
        row = row_of(fit.structure)
        subject = f"{row.title}'s prewhitened residuals" if row.prewhitened else "residuals"
        sentence = f"{subject} {whites[0]}"
    else:
        subject = f" of {join_names(coloured)}" if coloured else ""
        sentence = f"the residuals{subject} are {'coloured' if coloured else 'white'}"
    if all(isnan(white.p_value) for white in whites):
        return sentence
    if explains_nothing(fit):
        return f"{sentence}, but the model explains hardly anything of {join_names(fit.outputs)}"
    if not fit.trusts_coefficients:
        return f"{sentence}: trust neither {std} nor {robust}"
    return f"{sentence}: trust {f'{robust}, not {std}' if fit.trusts_robust else std}"


def latex(fit: Fit) -> str:
    r"""Return the equation as an `aligned` block, each coefficient with its standard deviation."""
    equation = form(fit).replace(") e(t)", r")\,e(t)").replace("1/D(q)", r"\frac{1}{D(q)}")
    for ratio in ("B(q)/F(q)", "B(s)/F(s)", "C(q)/D(q)"):
        equation = equation.replace(ratio, rf"\frac{{{ratio[:4]}}}{{{ratio[5:]}}}")
    equation = equation.replace(") y(t)", r")\,y(t)").replace(" u(t", r"\,u(t")
    equation = equation.replace("delay", r"\mathrm{delay}")
    body = " \\\\\n".join([equation.replace(" = ", " &= "), *_definitions(fit, _LATEX)])
    return f"\\begin{{aligned}}\n{body}\n\\end{{aligned}}"


def typst(fit: Fit) -> str:
    """Return the equation as a block of Typst mathematics, with the content of `latex`."""
    rows = [typst_form(fit).replace(" = ", " &= "), *_definitions(fit, _TYPST)]
    return "$ " + " \\\n  ".join(rows) + " $"


def typst_form(model: Fit) -> str:
    """Return the equation in Typst mathematics, with the letters of the polynomials."""
    text = form(model).replace(") ", ") thin ").replace("thin =", "=").replace("thin +", "+")
    return text.replace("delay", '"delay"')  # Typst takes other words for variables


class _Notation(NamedTuple):
    """Templates of a coefficient."""

    term: str
    """Template of value, standard deviation and power."""
    power: str
    """Template of a power of q or s."""
    times_ten: str
    """Template of mantissa and exponent."""
    space: str = " "
    """Space before a power."""
    unknown: str = "?"
    """Text of a number that is not finite; "" for Python's text."""


_PLAIN = _Notation(
    "{value} (±{std}){power}", " {variable}^{exponent}", "{mantissa}e{exponent:+03d}", " ", ""
)
_LATEX = _Notation(
    r"({value} \pm {std}){power}",
    r"\,{variable}^{{{exponent}}}",
    r"{mantissa} \cdot 10^{{{exponent}}}",
    r"\,",
)
_TYPST = _Notation(
    "({value} plus.minus {std}){power}",
    " thin {variable}^({exponent})",
    "{mantissa} dot 10^({exponent})",
    " thin ",
)


def _definitions(fit: Fit, notation: _Notation, equals: str = "&=") -> Iterator[str]:
    """Yield the definition of each polynomial."""
    for x in letters(fit):
        yield f"{x}({_variable(fit, x)}) {equals} {_polynomial(fit, x, notation)}"


def _polynomial(fit: Fit, letter: str, notation: _Notation) -> str:
    first = fit.nk if letter == "B" else 1
    variable, last = _variable(fit, letter), fit.polynomial(letter).size - 1

    def power(k: int) -> str:
        exponent = last - k if variable == "s" else -k
        if exponent == 1:
            return notation.power.partition("^")[0].format(variable=variable)
        return notation.power.format(variable=variable, exponent=exponent) if exponent else ""

    values, deviations = fit.polynomial(letter)[first:], fit.std[fit.slice_of(letter.lower())]
    if variable == "s" and letter == "F" and fit.integrator:  # the last coefficient is 0
        values, deviations = values[:-1], deviations[:-1]
    text = "" if letter == "B" else power(0).removeprefix(notation.space) or "1"
    for k, (value, std) in enumerate(zip(values, deviations, strict=True)):
        sign = ("-" if value < 0 else "") if not text else (" - " if value < 0 else " + ")
        term = notation.term.format(
            value=_number(abs(value), 5, notation),
            std=_number(std, 2, notation),
            power=power(first + k),
        )
        text += f"{sign}{term}"
    return text


def _number(x: float, digits: int, notation: _Notation) -> str:
    text = f"{x:.{digits}g}"
    if not isfinite(x):
        return notation.unknown or text
    mantissa, _, exponent = text.partition("e")
    if not exponent:
        return mantissa
    return notation.times_ten.format(mantissa=mantissa, exponent=int(exponent))


def html(fit: Fit) -> str:
    """Return the text of a model as HTML, below the equation of one channel for MathJax."""
    text = f"<pre>{escape(repr(fit))}</pre>"
    is_estimated_channel = (fit.ny, fit.nu) == (1, 1) and bool(fit.quality)
    return f"$$\n{latex(fit)}\n$$\n{text}" if is_estimated_channel else text


Labels = Sequence[str] | None


def labels_of(models: Sequence[Any], labels: Labels) -> list[str]:
    """Return the given labels, or the label of each model."""
    if labels is not None:
        return list(labels)
    # A python-control system has the attribute `name`.
    return [
        model.label if isinstance(model, Estimate) else str(getattr(model, "name", "model"))
        for model in models
    ]


def sources_of(models: Sequence[Any]) -> list[str]:
    """Return the hashes of the recordings that the models were identified from."""
    return [getattr(model, "source", "") for model in models]


def gain_unit(models: Sequence[Any], *, rate: bool = False) -> str:
    """Return the unit of y, or of its rate, per unit of u, from the first model with both units."""
    for model in models:
        if getattr(model, "unit", "") and getattr(model, "input_unit", ""):
            return f"{model.unit}{'/s' if rate else ''}/{model.input_unit}"
    return "–"


def with_method(name: str, band: Band) -> str:
    """Return a model's name, followed by the method of its 95 % band: linearised or by draws."""
    return f"{name}, 95 % {'by draws' if band.method == 'sampled' else band.method}"


def left_out(draws_by_name: Mapping[str, Draws | None], *, models: int) -> list[str]:
    """Return a line with the numbers of rejected draws of each model, if there are any."""
    counts = [
        f"{name}: {d.left_out}" if models > 1 else d.left_out
        for name, d in draws_by_name.items()
        if d is not None and d.left_out
    ]
    return [f"draws left out: {'; '.join(counts)}"] if counts else []


def short_lines(fit: Fit, *, roots: bool) -> list[str]:
    """Return lines with equation, signals, coefficients of each polynomial, poles and zeros.

    For several signals, the lines contain the quality of each output, and the poles. Each number
    has a standard deviation: σ robust if `fit.trusts_robust`, otherwise σ.
    """
    if (fit.ny, fit.nu) != (1, 1):
        return list(outputs_and_poles(fit))
    std, which = (fit.std_robust, "σ robust") if fit.trusts_robust else (fit.std, "σ")
    texts: dict[str, list[str]] = {}
    for letter, first in ((x.lower(), int(x != "B" or fit.Ts > 0)) for x in letters(fit)):
        part = fit.slice_of(letter)
        each = zip(fit.theta[part], std[part], strict=True)
        texts[f"{letter}{first} …"] = [with_std(float(x), float(s)) for x, s in each]
    lines = [f"  {_form_and_root(fit)}", f"  {signals(fit)}; below, ± is {which}"]
    lines += [f"  {name}   {_number_list(values)}" for name, values in texts.items()]
    if roots and fit.Ts == 0:
        lines += [f"  {line}" for line in repr(fit.quantities()).splitlines()]
    elif roots:
        lines += [f"  poles  {_roots(fit.poles())}", f"  zeros  {_roots(fit.zeros())}"]
    return lines


def _roots(roots: Roots) -> str:
    """Return the roots and their standard deviations as text; a complex pair is one text."""
    texts = []
    for z, (real, imag) in _each_root(roots):
        if z.imag > 0:
            least = min((s for s in (real, imag) if s > 0), default=0.0)
            decimals = min(places(least), _MAX_DECIMALS)
            pair = f"{z.real:.{decimals}f} ± {z.imag:.{decimals}f}i"
            texts.append(f"{pair} (σ {digits(real, 2)}, {digits(imag, 2)})")
        else:
            texts.append(near_one(z.real, real) if real else f"{z.real:g} (fixed)")
    return _number_list(texts) or "none"


def _each_root(roots: Roots) -> list[tuple[complex, list[float]]]:
    """Return each real root and each pair, with the deviations of its real and imaginary part."""
    with np.errstate(invalid="ignore"):  # rounding may make a variance negative
        stds = np.sqrt(np.diagonal(roots.covariance, axis1=1, axis2=2))
    each = zip(roots.values.tolist(), stds.tolist(), strict=True)
    return [(z, std) for z, std in each if z.imag >= 0]


def _number_list(numbers: Sequence[str]) -> str:
    """Return the numbers as text, separated by commas; a line break cannot divide a number."""
    return ", ".join(number.replace(" ", NBSP) for number in numbers)


def estimation_lines(fit: Fit) -> list[str]:
    """Return the equation, the coefficients with σ and σ robust, and the tests of a model."""
    if (fit.ny, fit.nu) != (1, 1):
        return list(_channel_lines(fit))
    squared = _unit_squared(fit.unit)
    lines = [
        heading(fit),
        f"  {_form_and_root(fit)}",
        *coefficients(fit),
        *root_lines(fit),
        f"  fit {fit.fit_percent:.2f} % one step ahead on estimation data",
        f"  loss {fit.loss:.4g}{squared}, FPE {fit.fpe:.4g}{squared}, AIC {fit.aic:.5g}",
        f"  {whiteness_sentence(fit, 'σ', 'σ robust')}",
    ]
    lines += _starts_lines(fit, squared)
    if fit.projection is not None:
        lines += [f"  {line}" for line in fit.explain().splitlines()]
    return lines


def _channel_lines(fit: Fit) -> Iterator[str]:
    """Yield the quality of each output, the poles, and the coefficients of each channel."""
    yield from outputs_and_poles(fit)
    for i, j, channel in fit.channels():
        yield f"{fit.inputs[j]} to {fit.outputs[i]}, delay {channel.nk} Ts"
        yield from coefficients(channel)
        yield from root_lines(channel)


def coefficients(fit: Fit) -> list[str]:
    """Return the table of the parameters."""
    lines = [f"  {'coefficient':12} {'estimate':>14} {'σ':>10} {'σ robust':>10}"]
    with np.errstate(invalid="ignore"):  # rounding may make a variance negative
        stds = fit.std, fit.std_robust
    rows = zip(fit.names, fit.theta, *stds, strict=True)
    for name, value, std, robust in rows:
        finite = [s for s in (std, robust) if np.isfinite(s) and s > 0]
        decimals = min(places(min(finite, default=0.0)), _MAX_DECIMALS)
        lines.append(
            f"  {_with_power(fit, name):12} {value:>14.{decimals}f} {_std(std)} {_std(robust)}"
        )
    return lines


def _with_power(fit: Fit, name: str) -> str:
    """Return the name of a parameter with its power of q or s, or the unit of a delay."""
    if name == "delay":
        return "delay [s]"
    k = int(name[1:])
    if _variable(fit, name[0].upper()) == "s":
        return f"{name} s^{fit.polynomial(name[0]).size - 1 - k}"
    return f"{name} q^-{k - 1 + fit.nk if name[0] == 'b' else k}"


def root_lines(fit: Fit) -> list[str]:
    """Return poles and zeros in the z plane or the s plane with their deviations, a row a pair."""
    root = f"root of {'z' if fit.Ts else 's'}"
    lines = [f"  {root:12} {'value':>22} {'σ':>10} {'σ of the imaginary part':>24}"]
    for name, roots in (("pole", fit.poles()), ("zero", fit.zeros())):
        for z, (real, imag) in _each_root(roots):
            pair = f" ± {z.imag:.5f}i" if z.imag > 0 else ""
            std = f"{'fixed':>10}" if real == 0 and not pair else _std(real)
            lines.append(
                f"  {name:12} {f'{z.real:.5f}{pair}':>22} "
                f"{std}{f' {digits(imag, 2):>24}' if pair else ''}"
            )
    return lines


def estimation_facts(fit: Fit) -> dict[str, Any]:
    """Return the results of the estimation as JSON fields.

    The values of several signals are a list with an item for each output or channel.
    """
    shared = {"converged": fit.search.converged, "warnings": list(fit.warnings)}
    if (fit.ny, fit.nu) != (1, 1):
        return _facts_of_each(fit) | shared
    facts = {
        **_fields(fit, "structure orders integrator Ts"),
        "parameters": _parameters(fit),
        **_fields(fit, "noise_variance loss fpe aic mdl fit_percent"),
        "p_white": fit.whiteness,
        "whiteness_test": fit.whiteness_test,
        **shared,
        "N": fit.N,
        "answers": fit.summary().facts(),
    }
    if fit.Ts == 0:
        facts["quantities"] = dict(fit.quantities())
    if fit.projection is not None:
        facts |= _fields(fit.projection, "canonical_correlations suggested_order")
    return facts


def _facts_of_each(fit: Fit) -> dict[str, Any]:
    """Return the results of each output and channel as JSON fields."""
    poles = fit.poles()
    return {
        "structure": fit.structure,
        "orders": fit.specification or fit.orders,
        "integrator": list(fit.form.integrators),
        **_fields(fit, "shared inputs outputs Ts"),
        "noise_covariance": fit.noise_covariance,
        **{name: [getattr(q, name) for q in fit.quality] for name in ("loss", "fit_percent", "N")},
        "p_white": [q.white.p_value for q in fit.quality],
        "whiteness_test": [q.white.test for q in fit.quality],
        "poles": [
            {"real": z.real, "imag": z.imag, "std": std}
            for z, std in zip(poles.values, poles.std, strict=True)
        ],
        "channels": [
            {
                "input": fit.inputs[j],
                "output": fit.outputs[i],
                "nk": channel.nk,
                "parameters": _parameters(channel),
            }
            for i, j, channel in fit.channels()
        ],
    }


def _parameters(channel: Fit) -> dict[str, dict[str, float]]:
    rows = zip(channel.names, channel.theta, channel.std, channel.std_robust, strict=True)
    return {name: {"value": v, "std": s, "std_robust": r} for name, v, s, r in rows}


def _form_and_root(fit: Fit) -> str:
    place = 1 if fit.Ts else 0
    text = f"; one root of {fit.integrating.upper()} is {place} by construction"
    root = text if fit.integrator else ""
    return f"{form(fit)}{root}"


def _std(std: float) -> str:
    return f"{digits(std, 2):>10}" if np.isfinite(std) else f"{'not known':>10}"


def _unit_squared(unit: str) -> str:
    return f" ({unit})²" if "/" in unit else f" {unit}²" if unit else ""


def _fields(fit: Fit | PastProjection, names: str) -> dict[str, Any]:
    return {name: getattr(fit, name) for name in names.split()}
