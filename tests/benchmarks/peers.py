"""Time and error of the frequency response of armrig and other programs on the same data.

Three cases; the error is the rms of |G/G_0 - 1| over 200 logarithmic frequencies::

    arm    the handout's arm, u to theta_1, Ts 10 ms, N = 3000, telegraph 0/5 V with p = 0.05,
           white noise of 5 mrad; 0.5-100 rad/s
    OE     B = q^-1 + 0.5 q^-2 + 0.2 q^-3 over F = (1 - 1.5 q^-1 + 0.9 q^-2)(1 - 0.6 q^-1),
           N = 10 000, telegraph ±1 V with p = 0.3, white noise of sd 1; 0.01-3.1 rad/sample
    BJ     the same, noise (1 + 0.5 q^-1) / (1 - 0.8 q^-1) e, sd of e 1

Each method runs in a process of its own, limited to two minutes, with the true orders and a delay
of one sample. Its other settings are its makers' defaults. A run on 300 samples, not timed, loads
it first. The table has the median over the data sets (`runs`, 3 by default). Peers live in an
environment of their own, so that they touch nothing of the project's::

    python3 -m venv peers
    peers/bin/pip install sippy_unipi pysib nfoursid timeseries-toolbox
    python -m tests.benchmarks.peers peers/bin/python [runs]    # with the project's environment

Octave with its package control is taken where it is installed. `peers.py arm [seeds]` prints the
figure of the arm alone, over 100 seeds.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

B3 = [0.0, 1.0, 0.5, 0.2]
F3 = np.convolve([1.0, -1.5, 0.9], [1.0, -0.6])
ORDERS = {"arm": 4, "OE": 3, "BJ": 3}
METHODS = {
    "armrig": ("oe", "bj", "n4sid", "arx"),
    "sippy_unipi": ("OE", "BJ", "CVA", "N4SID"),
    "pysib": ("oe", "sm", "bj", "arx"),
    "nfoursid": ("N4SID",),
    "timeseries-toolbox": ("bjtf, no noise model", "bjtf"),
    "Octave control": ("n4sid", "arx"),
}
LIMIT_S = 120.0
Response = tuple[Any, Any]


def main() -> None:
    """Run a worker, the arm alone, or the table."""
    if sys.argv[1] == "--worker":
        _work(sys.argv[2], sys.argv[3], Path(sys.argv[4]))
    elif sys.argv[1] == "arm":
        _arm_alone(int(sys.argv[2]) if len(sys.argv) > 2 else 100)
    else:
        _table(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 3)


def dataset(case: str, seed: int) -> dict[str, Any]:
    """Return u, y, Ts and the truth of a case."""
    from armrig import telegraph
    from armrig.numerics.polynomial import apply_filter

    rng = np.random.default_rng([seed, 2026])
    if case == "arm":
        B, F = _arm()
        u = telegraph(3000, 0.05, 0.0, 5.0, seed=rng)
        y = apply_filter(B, F, u) + 5e-3 * rng.standard_normal(u.size)
        return {"u": u, "y": y, "Ts": 0.01, "B": B, "F": F, "n": 4}
    u = telegraph(10_000, 0.3, 1.5, 3.5, seed=rng) - 2.5
    e = rng.standard_normal(u.size)
    v = e if case == "OE" else apply_filter([1.0, 0.5], [1.0, -0.8], e)
    return {"u": u, "y": apply_filter(B3, F3, u) + v, "Ts": 1.0, "B": B3, "F": F3, "n": 3}


def _arm() -> tuple[Any, Any]:
    from armrig_core.rig.arm import ArmParameters, arm_matrices, zero_order_hold

    A, B, C = arm_matrices(ArmParameters())
    Phi, x = zero_order_hold(A, B, 0.01)
    F = np.real(np.poly(Phi))
    markov = [0.0]
    for _ in range(4):
        markov.append(float((C @ x)[0, 0]))
        x = Phi @ x
    return np.convolve(markov, F)[:5], F


def _error(data: dict[str, Any], B: Any, F: Any) -> float:
    arm = float(data["Ts"]) < 1
    omega = np.geomspace(0.5, 100.0, 200) if arm else np.geomspace(0.01, 3.1, 200)
    x = np.exp(-1j * omega * float(data["Ts"]))
    G, truth = (
        np.polyval(np.asarray(b)[::-1], x) / np.polyval(np.asarray(f)[::-1], x)
        for b, f in ((B, F), (data["B"], data["F"]))
    )
    return float(np.sqrt(np.mean(np.abs(G / truth - 1) ** 2)))


def _arm_alone(seeds: int) -> None:
    from armrig import Dataset, n4sid, oe

    for name, estimate in (
        ("OE with the integrator", lambda d: oe(d, nb=4, nf=4, integrator=True)),
        ("N4SID with the integrator", lambda d: n4sid(d, 4, integrator=True)),
    ):
        errors, seconds = [], []
        for seed in range(seeds):
            data = dataset("arm", seed)
            begun = time.perf_counter()
            fit = estimate(Dataset(u=data["u"], y=data["y"], Ts=0.01))
            seconds.append(time.perf_counter() - begun)
            errors.append(_error(data, fit.B, fit.denominator))
        print(
            f"{name}: relative error median {np.median(errors):.4f}, worst {max(errors):.4f} of "
            f"{seeds} seeds; {1e3 * np.median(seconds):.0f} ms",
            flush=True,
        )


def _table(python: str, runs: int) -> None:
    octave = shutil.which("octave-cli") or shutil.which("octave")
    print("| program | method | " + " | ".join(f"{c}: error | s" for c in ORDERS) + " |")
    print("|---|---|" + "---:|---:|" * len(ORDERS))
    with tempfile.TemporaryDirectory() as folder:
        files = {c: [_written(Path(folder), c, seed) for seed in range(runs)] for c in ORDERS}
        for program, methods in METHODS.items():
            for method in methods:
                cells = []
                for case in ORDERS:
                    found = [
                        _run(program, method, path, python=python, octave=octave)
                        for path in files[case]
                    ]
                    cells += _cells(found, [np.load(p) for p in files[case]])
                print(f"| {program} | {method} | {' | '.join(cells)} |", flush=True)


def _written(folder: Path, case: str, seed: int) -> Path:
    path = folder / f"{case}-{seed}.npz"
    data = dataset(case, seed)
    np.savez(path, **data)
    both = np.column_stack([data["u"], data["y"]])
    np.savetxt(path.with_suffix(".txt"), both, fmt="%.17g")
    return path


def _cells(found: list[dict[str, Any] | str], data: list[Any]) -> list[str]:
    good = [(f, d) for f, d in zip(found, data, strict=True) if not isinstance(f, str)]
    if not good:
        return [str(found[0]), ""]
    errors = [_error(d, f["B"], f["F"]) for f, d in good]
    missing = f" ({len(found) - len(good)} failed)" if len(good) < len(found) else ""
    return [f"{np.median(errors):.2g}{missing}", f"{np.median([f['s'] for f, _ in good]):.3g}"]


def _run(
    program: str, method: str, path: Path, *, python: str, octave: str | None
) -> dict[str, Any] | str:
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    if program == "Octave control":
        if octave is None:
            return "not installed"
        order, Ts = (4, 0.01) if path.stem.startswith("arm") else (3, 1.0)
        script = _OCTAVE.format(path=path.with_suffix(".txt"), Ts=Ts, n=order, method=method)
        command = [octave, "--no-gui", "--no-window-system", "--eval", script]
    else:
        runner = sys.executable if program == "armrig" else python
        command = [runner, __file__, "--worker", program, method, str(path)]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=LIMIT_S, env=environment, check=False
        )
    except subprocess.TimeoutExpired:
        return f"> {LIMIT_S:.0f} s"
    lines = [x for x in done.stdout.splitlines() if x.startswith("{")]
    if not lines:
        return "failed"
    found: dict[str, Any] = json.loads(lines[-1])
    finite = np.isfinite(found["B"]).all() and np.isfinite(found["F"]).all()
    return found if finite else "not finite"


_OCTAVE = """
pkg load control;
d = load('{path}');
function [B, F] = model(d, Ts, n, method)
  data = iddata(d(:, 2), d(:, 1), Ts);
  if strcmp(method, 'n4sid')
    sys = n4sid(data, n);
  else
    sys = arx(data, 'na', n, 'nb', n);
  endif
  [B, F] = tfdata(tf(sys(1, 1)), 'vector');
endfunction
model(d(1:300, :), {Ts}, {n}, '{method}');
tic;
[B, F] = model(d, {Ts}, {n}, '{method}');
s = toc;
B = [zeros(1, numel(F) - numel(B)), B];
list = @(x) strjoin(arrayfun(@(v) sprintf('%.17g', v), x, 'UniformOutput', false), ',');
printf('{{"B": [%s], "F": [%s], "s": %.9g}}\\n', list(B), list(F), s);
"""


def _work(program: str, method: str, path: Path) -> None:
    """Estimate in this process and print the model and the seconds."""
    data = np.load(path)
    u, y, Ts, n = data["u"], data["y"], float(data["Ts"]), int(data["n"])
    estimate = _ESTIMATES[program]
    warnings.simplefilter("ignore")
    # Not at all where that is too short for it: then the time includes loading.
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(Exception):
        estimate(method, u[:300], y[:300], Ts, n)
    with contextlib.redirect_stdout(io.StringIO()):
        begun = time.perf_counter()
        B, F = estimate(method, u, y, Ts, n)
        seconds = time.perf_counter() - begun
    B, F = (np.asarray(p, dtype=float).ravel().tolist() for p in (B, F))
    print(json.dumps({"B": B, "F": F, "s": seconds}))


def _armrig(method: str, u: Any, y: Any, Ts: float, n: int) -> Response:
    import armrig

    data = armrig.Dataset(u=u, y=y, Ts=Ts)
    integrator = Ts < 1
    fit = {
        "arx": lambda: armrig.arx(data, na=n, nb=n),
        "oe": lambda: armrig.oe(data, nb=n, nf=n, integrator=integrator),
        "bj": lambda: armrig.bj(data, nb=n, nc=1, nd=1, nf=n, integrator=integrator),
        "n4sid": lambda: armrig.n4sid(data, n, integrator=integrator),
    }[method]()
    return fit.B, fit.denominator


def _sippy(method: str, u: Any, y: Any, Ts: float, n: int) -> Response:
    from sippy_unipi import system_identification

    # Its delays count beyond the one sample that it always has.
    orders = {"OE": {"OE_orders": [n, n, 0]}, "BJ": {"BJ_orders": [n, 1, 1, n, 0]}}
    chosen = orders.get(method, {"SS_fixed_order": n})
    model = system_identification(y, u, method, tsample=Ts, **chosen)
    return _transfer(model.G)


def _transfer(G: Any) -> Response:
    """Return B and F in q^-1 of a python-control system."""
    import control

    tf = control.tf(G)
    num, den = np.ravel(tf.num[0][0]), np.ravel(tf.den[0][0])
    return np.append(np.zeros(den.size - num.size), num), den


def _pysib(method: str, u: Any, y: Any, Ts: float, n: int) -> Response:
    import pysib

    arguments = {"bj": (n, 1, 1, n, 1), "arx": (n, n, 1)}.get(method, (n, n, 1))
    _, m = getattr(pysib, method)(u, y, *arguments)
    return m["B"], np.convolve(np.ravel(m["A"]), np.ravel(m["F"]))


def _nfoursid(method: str, u: Any, y: Any, Ts: float, n: int) -> Response:
    import control
    import pandas as pd
    from nfoursid.nfoursid import NFourSID

    frame = pd.DataFrame({"u": u, "y": y})
    # Its default of 2 block rows cannot show more than two states.
    found = NFourSID(frame, output_columns=["y"], input_columns=["u"], num_block_rows=15)
    found.subspace_identification()
    space, _ = found.system_identification(rank=n)
    return _transfer(control.ss(space.a, space.b, space.c, space.d, Ts))


def _timeseries(method: str, u: Any, y: Any, Ts: float, n: int) -> Response:
    from TimeSeriesSRC.Model.estimate import estimate
    from TimeSeriesSRC.Model.model import pmodel

    m = int(method == "bjtf")
    np.random.seed(0)  # noqa: NPY002  # its start values are drawn from the global generator
    # Its nb counts the coefficients after the first.
    model = pmodel("bjtf", nb=[n - 1], nf=[n], nc=[m], nd=[m], delay=[1], diff=[0], per=[])
    model, *_ = estimate(model, y, u, show_plot=False, show_output=False)
    b, f = (np.ravel(np.asarray(p[0], dtype=float)) for p in (model.b, model.f))
    return np.append(0.0, b), f if f.size == n + 1 else np.append(1.0, f)


_ESTIMATES = {
    "armrig": _armrig,
    "sippy_unipi": _sippy,
    "pysib": _pysib,
    "nfoursid": _nfoursid,
    "timeseries-toolbox": _timeseries,
}


if __name__ == "__main__":
    main()
