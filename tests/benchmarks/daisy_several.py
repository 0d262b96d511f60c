"""Simulated fit of `ss` for real plants, next to slra, MATLAB's pem, Octave's n4sid and nfoursid.

The records are from DaISy (B. De Moor, ed., KU Leuven), which is not part of this project. The
first 70 % estimate an output-error model with a direct term, and the last 30 % validate it. All
signals are centred, and the initial state is free. With the Frobenius norm, the fit is ::

    100 (1 - |y - yhat| / |y - mean y|)

The published values are read off figure 4 of I. Markovsky, "Software for identification in the
behavioural setting" (`ident.pdf` of the package slra, +-0.5). The first nine examples of the figure
have other numbers in its table: robot_arm is number 9, dryer2 is number 5 and heating_system is
number 4. The fits of these records by `ss` show it.

Run it with the project's environment; the last argument is a Python that has nfoursid and scipy::

    python -m tests.benchmarks.daisy_several FOLDER [PYTHON]
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import armrig
import numpy as np
from armrig import Fit, Signals
from armrig.models.matrices import Matrices
from scipy.io import loadmat, savemat

RECORDS = {
    "heating_system": ([1], [2], 2, "94.5 / 76.0 (slra)"),
    "robot_arm": ([0], [1], 4, "97.1 / 96.6 (slra, pem)"),
    "CD_player_arm": ([0, 1], [2, 3], 2, "77.0 / 77.0 (slra), 79.4 / 79.7 (pem)"),
    "dryer2": ([1, 2, 3], [4, 5, 6], 3, "80.3 / 25.7 (slra), 79.4 / 14.3 (pem)"),
    "steamgen": ([1, 2, 3, 4], [5, 6, 7, 8], 4, "83.4 / 81.6 (slra), 47.3 / 53.1 (pem)"),
    "glassfurnace": ([1, 2, 3], [4, 5, 6, 7, 8, 9], 6, "not in the figure"),
}
"""Columns of u and y, order, and published fits of the two parts in %."""
_OCTAVE = """
pkg load control
load("{folder}/in.mat");
data = iddata(y, u, 1);
tic; [sys, x0] = n4sid(data, n); seconds = toc;
[A, B, C, D] = ssdata(sys);
save("-v6", "{folder}/out.mat", "A", "B", "C", "D", "seconds");
"""
_NFOURSID = """
import json, sys, time
import numpy as np, pandas as pd
from nfoursid.nfoursid import NFourSID
from scipy.io import loadmat
of = loadmat(sys.argv[1])
u, y = of["u"], of["y"]
us, ys = [f"u{k}" for k in range(u.shape[1])], [f"y{k}" for k in range(y.shape[1])]
table = pd.DataFrame(np.hstack([u, y]), columns=us + ys)
begin = time.perf_counter()
found = NFourSID(table, output_columns=ys, input_columns=us, num_block_rows=int(of["rows"][0, 0]))
found.subspace_identification()
model, _ = found.system_identification(rank=int(of["n"][0, 0]))
seconds = time.perf_counter() - begin
print(json.dumps({k: getattr(model, k.lower()).tolist() for k in "ABCD"} | {"seconds": seconds}))
"""


def main() -> None:
    """Print the fits of both parts and the time of each program."""
    folder = Path(sys.argv[1])
    nfoursid = sys.argv[2] if len(sys.argv) > 2 else None
    for name, (inputs, outputs, n, published) in RECORDS.items():
        table = np.loadtxt(folder / f"{name}.dat")
        table = table - table.mean(axis=0)
        signals = Signals(u=table[:, inputs], y=table[:, outputs], Ts=1.0)
        cut = int(np.ceil(0.7 * signals.N))
        parts = signals[:cut], signals[cut:]
        print(f"{name}, order {n}; published: {published}")
        for label, weights in (("ss", None), ("ss, equal weights", [1.0] * signals.ny)):
            begin = time.perf_counter()
            fit = armrig.ss(parts[0], order=n, nk=0, noise=False, output_weights=weights)
            _say(label, fit, parts, time.perf_counter() - begin)
        for label, focus in (("n4sid", "prediction"), ("n4sid, simulation", "simulation")):
            begin = time.perf_counter()
            own = armrig.n4sid(parts[0], n, nk=0, focus=focus, replicates=0)
            _say(label, own, parts, time.perf_counter() - begin)
        for label, found in (
            ("Octave's n4sid", _octave(parts[0], n) if shutil.which("octave-cli") else None),
            ("nfoursid", _nfoursid(nfoursid, parts[0], n) if nfoursid else None),
        ):
            if found is None:
                continue
            form, seconds = found
            unknown = np.zeros((form.theta.size,) * 2)
            other = replace(fit, form=form, covariance=unknown, covariance_robust=unknown)
            _say(label, other, parts, seconds)


def _say(label: str, fit: Fit, parts: tuple[Signals, Signals], seconds: float) -> None:
    """Print one line."""
    fits = []
    for part in parts:
        predicted = fit.predict(part, None).reshape(part.y.shape)  # (N,) for one channel
        e, spread = part.y - predicted, part.y - part.y.mean(axis=0)
        fits.append(100 * (1 - np.linalg.norm(e) / np.linalg.norm(spread)))
    print(f"    {label:18} {fits[0]:6.1f} / {fits[1]:5.1f}   {seconds:6.2f} s", flush=True)


def _octave(data: Signals, n: int) -> tuple[Matrices, float] | None:
    with tempfile.TemporaryDirectory() as folder:
        savemat(Path(folder) / "in.mat", {"u": data.u, "y": data.y, "n": float(n)})
        command = ["octave-cli", "--no-gui", "--quiet", "--eval", _OCTAVE.format(folder=folder)]
        if subprocess.run(command, stderr=subprocess.DEVNULL).returncode:
            return None
        of = loadmat(Path(folder) / "out.mat")
    return _form(of["A"], of["B"], of["C"], of["D"]), float(of["seconds"][0, 0])


def _nfoursid(python: str, data: Signals, n: int) -> tuple[Matrices, float] | None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "in.mat"
        savemat(file, {"u": data.u, "y": data.y, "n": n, "rows": max(10, 2 * n)})
        command = [python, "-c", _NFOURSID, str(file)]
        done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        return None
    of = json.loads(done.stdout)
    return _form(*(np.array(of[name]) for name in "ABCD")), of["seconds"]


def _form(*matrices: np.ndarray) -> Matrices:
    A, B, C, D = matrices
    K = np.zeros((A.shape[0], C.shape[0]))
    return Matrices(A=A, B=B, C=C, D=D, K=K, nk=(0,) * B.shape[1])


if __name__ == "__main__":
    main()
