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
        bench = Bench(scratch, terminal=True)
        try:
            bench.configure(more=_UNKNOWN)
            bench.emulate()
            _calibrate(bench, folder)
            _play(bench, folder)
        finally:
            bench.end()
    _estimate(folder)


def _estimate(folder: Path) -> None:
    """Save a model of each kind, and the facts about all files."""
    recording = armrig.load(folder / "scheduled.mcap")
    data, several = recording.dataset(output="alpha"), recording.signals()
    fits: dict[str, armrig.Fit] = {
        "arx": armrig.arx(data, na=2, nb=2),
        "armax": armrig.armax(data, na=2, nb=2, nc=1),
        "ararx": armrig.ararx(data, na=2, nb=2, nd=1),
        "oe": armrig.oe(recording.dataset(output="theta_1"), nb=2, nf=2, integrator=True),
        "bj": armrig.bj(data, nb=2, nc=1, nd=1, nf=2),
        "iv4": armrig.iv4(data, na=2, nb=2),
        "pem": armrig.pem(data, nb=1, na=1, nc=1, nf=1),
        "n4sid": armrig.n4sid(data, 2),
        "arx_of_two": armrig.arx(several, na=1, nb=1),
        "ss_of_two": armrig.ss(several, order=2),
    }
    found: dict[str, Any] = {p: facts(armrig.load(folder / f"{p}.mcap")) for p in PACINGS}
    for name, fit in fits.items():
        path = folder / f"{name}.json"
        fit.save(path)
        path.write_text(json.dumps(json.loads(path.read_text()), ensure_ascii=False) + "\n")
        found[name] = answers(fit, recording)
    lines = ",\n".join(f'"{name}": {json.dumps(fact)}' for name, fact in found.items())
    (folder / "facts.json").write_text(f"{{\n{lines}\n}}\n")


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


def answers(fit: armrig.Fit, recording: armrig.Recording) -> dict[str, Any]:
    """Return a model's answers: its poles, and y one step ahead at every 30th sample."""
    if (fit.ny, fit.nu) == (1, 1):
        predicted = fit.predict(recording.dataset(output=fit.output))
    else:
        predicted = fit.predict(recording.signals(fit.outputs)).ravel()
    return {
        "poles": [[p.real, p.imag] for p in fit.poles().values.tolist()],
        "predicted": predicted[np.isfinite(predicted)][::30].tolist(),
    }


def _calibrate(bench: Bench, folder: Path) -> None:
    daemon = bench.serve()
    subprocess.run(
        [
            *(sys.executable, "-m", "armrig", "calibrate", "--yes", "--json"),
            *("--connect", f"unixsock-stream/{bench.folder}/armrig/1.sock"),
            *("--volts", "5", "--level-seconds", "4", "--rest-seconds", "0.5", "--Ts", "0.02"),
            *("--meter", "32768=2.5", "--save", str(folder / "calibration.toml")),
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
