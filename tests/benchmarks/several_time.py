"""Processor time of `ss` and `n4sid` for two inputs and outputs, next to Octave's n4sid.

The plants are those of `ss_optimum` with two inputs and outputs and order 6. The programs take
turns, and each of them runs `--repeat` times; the least time counts. `n4sid` has no replicates,
because Octave's n4sid estimates no standard deviations. Run it with the project's environment::

    OPENBLAS_NUM_THREADS=1 python -m tests.benchmarks.several_time [--first 0] [--plants 6]
        [--N 10000] [--repeat 5]
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import armrig
import numpy as np
from armrig import Signals
from scipy.io import loadmat, savemat

from tests.benchmarks.octave_models import have_octave
from tests.benchmarks.ss_optimum import drawn

_ORDER = 6
_OCTAVE = """
pkg load control
load("{folder}/in.mat");
data = iddata(y, u, 1);
sys = n4sid(data, n);
seconds = Inf;
for k = 1:repeat
  begin = cputime; sys = n4sid(data, n); seconds = min(seconds, cputime - begin);
end
save("-v6", "{folder}/out.mat", "seconds");
"""


def main() -> None:
    """Print a line for each plant, and the medians."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--plants", type=int, default=6)
    parser.add_argument("--N", type=int, default=10_000)
    parser.add_argument("--repeat", type=int, default=5)
    given = parser.parse_args()
    rows: list[tuple[float, float, float]] = []
    seed = given.first
    while len(rows) < given.plants:
        data, A, _, _ = drawn(seed, given.N)
        if (data.nu, data.ny, A.shape[0]) == (2, 2, _ORDER):
            ss = _least(lambda data=data: armrig.ss(data, order=_ORDER), 1)  # type: ignore[misc]
            own = _least(
                lambda data=data: armrig.n4sid(data, _ORDER, replicates=0),  # type: ignore[misc]
                given.repeat,
            )
            octave = _octave(data, given.repeat) if have_octave() else np.nan
            rows.append((ss, own, octave))
            print(
                f"seed {seed}: ss {ss:.2f} s, n4sid {1e3 * own:.1f} ms, Octave's n4sid "
                f"{1e3 * octave:.1f} ms, ratio {own / octave:.2f}",
                flush=True,
            )
        seed += 1
    ss, own, octave = np.median(rows, axis=0)
    print(f"median: ss {ss:.2f} s, n4sid {1e3 * own:.1f} ms, ratio {own / octave:.2f}")


def _least(call: Callable[[], object], repeat: int) -> float:
    """Return the least processor time of the calls, in s."""
    times = []
    for _ in range(repeat):
        begin = time.process_time()
        call()
        times.append(time.process_time() - begin)
    return min(times)


def _octave(data: Signals, repeat: int) -> float:
    """Return the least processor time of Octave's n4sid, in s."""
    with tempfile.TemporaryDirectory() as folder:
        content = {"u": data.u, "y": data.y, "n": float(_ORDER), "repeat": float(repeat)}
        savemat(Path(folder) / "in.mat", content)
        command = ["octave-cli", "--no-gui", "--quiet", "--eval", _OCTAVE.format(folder=folder)]
        subprocess.run(command, stderr=subprocess.DEVNULL, check=True)
        return float(loadmat(Path(folder) / "out.mat")["seconds"][0, 0])


if __name__ == "__main__":
    main()
