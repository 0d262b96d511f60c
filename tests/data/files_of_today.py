"""Files of today's formats, and what is read from them.

`python -m tests.data.files_of_today FOLDER` makes them.

An emulated rig whose potentiometers nobody has seen is calibrated, then played on over a line that
spoils some frames; FOLDER is to be new. `README.md` says what is in one.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import armrig
import numpy as np

from tests.integration.processes import Bench
from tests.integration.relay import Relay

SEED, A = 1, 0.1
PACINGS: tuple[Literal["scheduled", "exchange"], ...] = ("scheduled", "exchange")
_UNKNOWN = """
theta_1_reversed = true
theta_1_range_deg = 340.0
theta_1_zero_deg = 100.0
theta_1_low_v = 0.2
alpha_zero_deg = 170.0
"""
_USED = '[calibration]\nfile = "calibration.toml"'
# A manifest names the kernel that it was recorded on; that of the maker's machine is nobody's.
_NO_KERNEL = """
import platform
uname = platform.uname()
platform.uname = lambda: platform.uname_result("Linux", "", "6.12", "Debian", uname.machine)
"""


def main(folder: Path) -> None:
    """Make all of it."""
    folder.mkdir(parents=True)
    with tempfile.TemporaryDirectory(prefix="rig-") as name:
        scratch = Path(name)
        (scratch / "sitecustomize.py").write_text(_NO_KERNEL)
        os.environ["PYTHONPATH"] = str(scratch)
        bench = Bench(scratch)
        try:
            bench.configure(more=_UNKNOWN)
            bench.emulate()
            _calibrate(bench, folder)
            _play(bench, folder)
        finally:
            bench.end()
    data = armrig.load(folder / "scheduled.mcap").dataset(output="alpha")
    fits = {
        "bj": armrig.bj(data, nb=2, nc=1, nd=1, nf=2, nk=1),
        "n4sid": armrig.n4sid(data, 2),
    }
    told = {pacing: facts(armrig.load(folder / f"{pacing}.mcap")) for pacing in PACINGS}
    for name, fit in fits.items():
        fit.save(folder / f"{name}.json")
        told[name] = answers(fit, data)
    (folder / "facts.json").write_text(json.dumps(told, indent=1) + "\n")


def facts(recording: armrig.Recording) -> dict[str, Any]:
    """Return the content of a recording, arrays as fingerprints of their bits."""
    gaps = [[g.k_first, g.count, g.t, g.u_held_v, g.reason] for g in recording.gaps]
    return {
        "sha256": recording.sha256,
        "pacing": recording.manifest.pacing,
        "k_first": recording.k_first,
        "N": recording.N,
        "samples": sha256(recording.samples.tobytes()).hexdigest(),
        "gaps": gaps,
        "events": [[e.t, e.level, e.message] for e in recording.events],
        "t": sha256(recording.t.tobytes()).hexdigest(),
        "theta_1": recording.dataset(output="theta_1").digest,
        "alpha": recording.dataset(output="alpha").digest,
    }


def answers(fit: armrig.Fit, data: armrig.Dataset) -> dict[str, Any]:
    """Return a model's answers: its poles, and y one step ahead if it is known."""
    predicted = fit.predict(data)
    return {
        "poles": [[p.real, p.imag] for p in fit.poles().values.tolist()],
        "predicted": predicted[np.isfinite(predicted)].tolist(),
    }


def _calibrate(bench: Bench, folder: Path) -> None:
    daemon = bench.serve()
    subprocess.run(
        [
            *(sys.executable, "-m", "armrig", "calibrate", "--yes", "--json"),
            *("--connect", f"unixsock-stream/{bench.folder}/armrig/1.sock"),
            *("--volts", "5", "--level-seconds", "4", "--rest-seconds", "0.5", "--Ts", "0.02"),
            *("--meter", "32768=2.5", "-o", str(folder / "calibration.toml")),
        ],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        check=True,
    )
    daemon.end()
    for name in ("calibration.toml", "calibration.csv.gz"):
        shutil.copy(folder / name, bench.folder)


def _play(bench: Bench, folder: Path) -> None:
    """Record 1.5 s in each mode, until frames were lost and the run went on."""
    line = Relay(bench.port, bench.folder / "line")
    try:
        bench.port = bench.folder / "line"
        bench.configure(more=_UNKNOWN + _USED)
        bench.serve()
        for pacing in PACINGS:
            path = None
            while path is None or not armrig.load(path).gaps:
                path = _recorded(bench, line, pacing)
            shutil.copy(path, folder / f"{pacing}.mcap")
    finally:
        line.end()


def _recorded(bench: Bench, line: Relay, pacing: Literal["scheduled", "exchange"]) -> Path | None:
    u = armrig.telegraph(150, A, low=0.5, high=4.5, seed=SEED)
    begun: list[int] = []

    def spoil(done: int, total: int) -> None:
        if done > total // 2 and not begun:
            begun.append(line.do("flip"))

    with bench.rig() as rig:
        try:
            rig.arm("a student", Ts=0.01)
            details = {"seed": SEED, "a": A}
            return rig.run(u, pacing=pacing, experiment="blackbox", details=details, progress=spoil)
        except armrig.RigError as tripped:
            print(f"{pacing}: {tripped}; once more")
            line.do("ends")
            rig.reset()
            return None
        finally:
            line.do("ends")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
