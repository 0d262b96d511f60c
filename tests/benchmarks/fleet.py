"""Many rigs through one router into one recorder: every sample of each is in its file.

`python -m tests.benchmarks.fleet --repeat 3`. Synthetic rigs are the daemon's own publishing code
with real messages, in at most four processes, without loop or emulator. In addition there are real
rigs, daemon and emulator, at 100 Hz. All connect by TLS with certificates, on the loopback. Every
file is read and checked for each k. The processor time is that of the seconds of publishing; the
time for completing the files afterwards is printed separately.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import armrig
import numpy as np
from armrig.lab import pki
from armrig_core import protobuf
from armrig_core.codes import GapCode
from armrig_core.telemetry import Sample, encode_sample
from armrig_daemon.config import Access, Config, Rig
from armrig_daemon.service.access import networks_of
from armrig_daemon.service.publish import Session

from tests.integration.laboratory import free_port
from tests.integration.processes import Bench, wait_for

TS_S = 0.001
PROCESSES = 4
_READY_S = 120.0
_END_S = 600.0


def cpu_s(pid: int) -> float:
    """Return the processor time that a process has used, in s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


# -- a process with synthetic rigs -----------------------------------------------------------------


def publish(folder: Path, router: str, ids: list[str], seconds: float) -> None:
    """Publish as so many daemons, after "go"; stay until the standard input ends."""
    with ExitStack() as stack:
        rigs = [stack.enter_context(_session(folder, router, rig)) for rig in ids]
        wait_for(lambda: all(rig.uplink and rig.uplink.has_router for rig in rigs), _READY_S)
        print("ready", flush=True)
        sys.stdin.readline()
        worst_s = _publish(rigs, round(seconds / TS_S))
        print(json.dumps({"worst_s": worst_s}), flush=True)
        sys.stdin.read()


def _session(folder: Path, router: str, rig: str) -> Session:
    access = Access(router=router, certificate=str(folder / "pki" / f"rig-{rig}.pem"))
    ways = networks_of(Config(rig=Rig(id=rig), access=access))
    return Session(f"unixsock-stream/{folder}/{rig}.sock", rig, lambda: None, *ways)


def _publish(rigs: list[Session], samples: int) -> float:
    """Publish that many samples of each rig; return how late the latest was, in s."""
    begun_ns = time.monotonic_ns()
    step_ns = round(TS_S * 1e9)
    worst_ns = 0
    for k in range(samples):
        due_ns = begun_ns + k * step_ns
        now_ns = time.monotonic_ns()
        if now_ns < due_ns:
            time.sleep((due_ns - now_ns) / 1e9)
        worst_ns = max(worst_ns, now_ns - due_ns)
        data = encode_sample(
            Sample(k, due_ns, due_ns + 60_000, k * 1000, 0.1 * k, 0.02, 2.5, 2.5, 31234, 33333, 3)
        )
        for rig in rigs:
            if k % 1000 == 0:
                rig.put("state", _state(due_ns))
            rig.put("sample", data)
    return worst_ns / 1e9


def _state(t_ns: int) -> bytes:
    message = protobuf.message_class(protobuf.STATE)(
        t_host_ns=t_ns, phase="active", owner="a benchmark", Ts_s=TS_S, device='{"uid": "7"}'
    )
    return bytes(message.SerializeToString())


# -- the whole -------------------------------------------------------------------------------------


def started(*command: str, folder: Path, **environ: str) -> subprocess.Popen[str]:
    """Start a program, and read its standard output."""
    return subprocess.Popen(
        [sys.executable, *command],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", **environ},
        cwd=folder,
    )


def round_of(rigs: int, real: int, seconds: float) -> dict[str, Any]:
    """Return the numbers of one round."""
    with tempfile.TemporaryDirectory(prefix="armrig-") as name:
        folder = Path(name)
        ids = [f"s{n}" for n in range(rigs)]
        certificates(folder, [*ids, *(f"real-{n}" for n in range(real))])
        router = f"tls/localhost:{free_port()}"
        benches = [Bench(_made(folder / f"bench-{n}")) for n in range(real)]
        programs: list[subprocess.Popen[str]] = []
        try:
            return _round(folder, router, ids, benches, programs, seconds)
        finally:
            for program in programs:
                program.kill()
                program.wait()
            for bench in benches:
                bench.end()


def certificates(folder: Path, ids: list[str]) -> None:
    """Make an authority with a router, rigs and a recorder."""
    made = folder / "pki"
    pki.make_authority(made)
    pki.issue_to_router(made, ["localhost"])
    pki.issue_to_person(made, "recorder", "observers")
    for rig in ids:
        pki.issue_to_rig(made, rig, [])


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _round(
    folder: Path,
    router: str,
    ids: list[str],
    benches: list[Bench],
    programs: list[subprocess.Popen[str]],
    seconds: float,
) -> dict[str, Any]:
    made = folder / "pki"
    routing = started(
        *("-m", "armrig", "router", "--listen", router),
        *("--certificate", str(made / "router.pem"), "--names", str(made / "access.toml")),
        folder=folder,
    )
    programs.append(routing)
    publishers = []
    for n in range(min(PROCESSES, len(ids))):
        share = ",".join(ids[n::PROCESSES])
        publishers.append(
            started(
                *("-m", "tests.benchmarks.fleet", "--publish"),
                *(share, router, str(folder), str(seconds)),
                folder=Path(__file__).parents[2],
            )
        )
    programs += publishers
    for n, bench in enumerate(benches):
        _serve(bench, f"real-{n}", router, made)
    for publisher in publishers:
        _read(publisher)
    recorder = started(
        *("-m", "armrig", "record", "--from", router, "--all", "-o", "files", "--json"),
        folder=folder,
        ARMRIG_CLIENT_CERTIFICATE=str(made / "recorder.pem"),
    )
    programs.append(recorder)
    time.sleep(5.0)
    kinds = {"publishers": publishers, "router": [routing], "recorder": [recorder]}
    before = {kind: sum(cpu_s(p.pid) for p in found) for kind, found in kinds.items()}
    begun = time.monotonic()
    for publisher in publishers:
        _say(publisher, "go")
    late = [json.loads(_read(publisher))["worst_s"] for publisher in publishers]
    took = time.monotonic() - begun
    used = {
        kind: (sum(cpu_s(p.pid) for p in found) - before[kind]) / took
        for kind, found in kinds.items()
    }
    time.sleep(1.0)
    behind = time.monotonic()
    recorder.send_signal(2)
    text, _ = recorder.communicate(timeout=_END_S)
    ended = time.monotonic() - behind
    files = json.loads(text)["recordings"]
    return {
        "rigs": len(ids),
        "seconds": round(took, 1),
        "cpu": {kind: round(value, 3) for kind, value in used.items()},
        "latest_s": round(max(late, default=0.0), 3),
        "completed_s": round(ended, 1),
        **_judged(folder, files, ids, round(seconds / TS_S)),
    }


def _serve(bench: Bench, rig: str, router: str, made: Path) -> None:
    bench.configure(
        watchdog_ms=250,
        more=f'[rig]\nid = "{rig}"\n[access]\nrouter = "{router}"\n'
        f'certificate = "{made}/rig-{rig}.pem"\n',
    )
    config = str(bench.config)
    bench.start("armrig_daemon", "emulate", "--port", str(bench.port), "--config", config)
    wait_for(bench.port_is_there, _READY_S)
    bench.start("armrig_daemon", "run", "--config", config)


def _judged(folder: Path, files: list[Any], ids: list[str], samples: int) -> dict[str, Any]:
    """Return how many rigs are complete, and how many samples are not there, by reading all."""
    found: dict[str, list[armrig.Recording]] = {}
    for file in files:
        found.setdefault(file["rig"], []).append(armrig.load(folder / file["recording"]))
    lost = 0
    for rig in ids:
        there = [part.samples["k"] for part in found.pop(rig, [])]
        every = np.concatenate([*there, np.array([], dtype=np.int64)])
        lost += samples - len(np.intersect1d(every, np.arange(samples)))
    real = {
        rig: {
            "samples": sum(part.samples.size for part in parts),
            "missing": sum(part.missing for part in parts),
            "of these on the way": sum(
                gap.count
                for part in parts
                for gap in part.gaps
                if gap.code == GapCode.RECORDER_CUT_OFF
            ),
        }
        for rig, parts in found.items()
    }
    return {"published": samples * len(ids), "lost": lost, "real": real}


def _read(program: subprocess.Popen[str]) -> str:
    assert program.stdout is not None
    line = program.stdout.readline()
    if not line:
        raise SystemExit("a program ended before its time")
    return line


def _say(program: subprocess.Popen[str], text: str) -> None:
    assert program.stdin is not None
    program.stdin.write(f"{text}\n")
    program.stdin.flush()


def main() -> None:
    """Run the rounds, and print each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=32)
    parser.add_argument("--real", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--publish", nargs=4, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.publish:
        ids, router, folder, seconds = given.publish
        publish(Path(folder), router, ids.split(","), float(seconds))
        return
    for _ in range(given.repeat):
        print(json.dumps(round_of(given.rigs, given.real, given.seconds)), flush=True)


if __name__ == "__main__":
    main()
