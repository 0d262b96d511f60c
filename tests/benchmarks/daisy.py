"""Four records of real plants: simulation by n4sid, arx, search and Octave's estimators.

The records are from DaISy (B. De Moor, ed., Database for the Identification of Systems, KU Leuven,
ESAT/STADIUS), which is not part of this project: give the folder that holds heating_system.dat,
exchanger.dat, robot_arm.dat and dryer.dat. Of each the first 40 % estimate, the next 30 % choose
orders (1 to 6) and methods, the last 30 % judge. The means of the first part are removed from all,
and each part is simulated with its initial state by least squares, the same way for all programs.
Octave has its n4sid and arx, their other settings by default; it is left out where it is not
installed. Run it with the project's environment::

    python -m tests.benchmarks.daisy FOLDER
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
from armrig import Dataset, arx, n4sid, search
from armrig.models.fit import Fit
from armrig.models.predictor import predictions
from scipy.io import loadmat, savemat

ORDERS = range(1, 7)
DELAYS = (0, 1)
RECORDS = {
    "heating_system": (1, 2, 2.0),
    "exchanger": (1, 2, 1.0),
    "robot_arm": (0, 1, 1.0),
    "dryer": (0, 1, 0.08),
}
"""Columns of u and y, and Ts in s; robot_arm's is not known."""
# An order at which an estimator fails is left out. C of n4sid is det(q - A + K C).
_OCTAVE = """
pkg load control
load("{folder}/in.mat");
warning("off", "all");
data = iddata(y, u, 1);
models = cell(0, 4);
for n = orders
  try
    [sys, x0, info] = n4sid(data, n);
    [a, b, c, d] = ssdata(sys);
    A = poly(a);
    models(end + 1, :) = {{"n4sid", A, poly(a - b * c) + (d - 1) * A, poly(a - info.K * c)}};
  end_try_catch
  try
    sys = arx(data, "na", n, "nb", n);
    [B, A] = tfdata(sys(1, 1), "vector");
    models(end + 1, :) = {{"arx", A, [zeros(1, numel(A) - numel(B)), B], 1}};
  end_try_catch
endfor
save("-v6", "{folder}/out.mat", "models");
"""


def main() -> None:
    """Print the fit on the last part, of what the middle part chose; and the loss on the first."""
    folder = Path(sys.argv[1])
    print("fit on the last part in % (orders; fit on the first part in %)")
    for name, (i, j, Ts) in RECORDS.items():
        first, middle, last = parts(np.loadtxt(folder / f"{name}.dat")[:, [i, j]], Ts)
        for method, models in _candidates(first).items():
            best = max(models, key=lambda m: fit_percent(m, middle))
            _say(name, method, best, first, last)
        found = search(first, middle, orders=ORDERS, nk=DELAYS)
        _say(name, "search", found.fit, first, last)


def parts(data: np.ndarray, Ts: float) -> list[Dataset]:
    """Return 40, 30 and 30 % of (u, y), less the means of the first."""
    N = len(data)
    cuts = [0, round(0.4 * N), round(0.7 * N), N]
    u, y = (data - data[: cuts[1]].mean(axis=0)).T
    return [Dataset(u=u[a:b], y=y[a:b], Ts=Ts) for a, b in pairwise(cuts)]


def fit_percent(model: Fit, data: Dataset) -> float:
    """Return 100 (1 - |y - ŷ| / |y - mean y|), simulated from the best initial state."""
    with np.errstate(all="ignore"):
        error = data.y - predictions(model, data, None)
    share = float(np.linalg.norm(error) / np.linalg.norm(data.y - data.y.mean()))
    return 100 * (1 - share) if np.isfinite(share) else -np.inf


def _candidates(first: Dataset) -> dict[str, list[Fit]]:
    models: dict[str, list[Fit]] = {
        "armrig n4sid": [n4sid(first, n, nk=nk) for n in ORDERS for nk in DELAYS],
        "armrig n4sid, simulation": [
            n4sid(first, n, nk=nk, focus="simulation") for n in ORDERS for nk in DELAYS
        ],
        "armrig arx": [arx(first, na=n, nb=n, nk=nk) for n in ORDERS for nk in DELAYS],
    }
    return models | (_octave(first) if shutil.which("octave-cli") else {})


def _octave(first: Dataset) -> dict[str, list[Fit]]:
    models: dict[str, list[Fit]] = {}
    with tempfile.TemporaryDirectory() as folder:
        found = {"u": first.u[:, None], "y": first.y[:, None], "orders": np.array([*ORDERS], float)}
        savemat(Path(folder) / "in.mat", found)
        command = ["octave-cli", "--no-gui", "--quiet", "--eval", _OCTAVE.format(folder=folder)]
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
        rows = loadmat(Path(folder) / "out.mat")["models"]
    for method, *polynomials in rows:
        A, B, C = (p.ravel() for p in polynomials)
        model = Fit.of_channel(A=A, B=B, C=C, nk=0, Ts=first.Ts)
        models.setdefault(f"Octave {method.item()}", []).append(model)
    return models | {"Octave, of both": [m for both in models.values() for m in both]}


def _say(name: str, method: str, model: Fit, first: Dataset, last: Dataset) -> None:
    print(
        f"{name:15} {method:25} {fit_percent(model, last):7.1f}  "
        f"({model.label}, {model.denominator.size - 1} poles; {fit_percent(model, first):.1f})",
        flush=True,
    )


if __name__ == "__main__":
    main()
