"""Several rigs of a lab and its router: sessions of daemons that publish on request."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import armrig
import zenoh
from armrig.lab import pki
from armrig.lab.fleet_recorder import FleetRecorder, RigRecorded
from armrig.lab.router import open_router
from armrig.rig.client import Rig
from armrig.rig.session import open_endpoint
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.telemetry import Sample, encode_sample
from armrig_daemon.config import Access, Config
from armrig_daemon.config import RigIdentity as RigTable
from armrig_daemon.service.access import networks_of
from armrig_daemon.service.publish import Session

from tests.integration.laboratory import certificates, free_port
from tests.integration.processes import Bench, Process, wait_for

RIGS = ("1", "2", "3")
WITHIN_S = 60
TS_S = 0.01


def sample(k: int) -> bytes:
    """Return sample k."""
    due = 5_000_000_000 + k * round(TS_S * 1e9)
    return encode_sample(Sample(k, due, due + 9, k * 10_000, 0.1, 0.0, 1.0, 1.0, 32768, 32768, 3))


def state(k: int) -> bytes:
    """Return the state at sample k."""
    message = protobuf.message_class(protobuf.STATE)(
        t_host_ns=5_000_000_000 + k * round(TS_S * 1e9),
        phase="safe",
        Ts_s=TS_S,
        device='{"uid": "7"}',
    )
    return bytes(message.SerializeToString())


class FleetLab:
    """Certificates for three rigs, a router and people, and where the router is."""

    def __init__(self, folder: Path, host: str = "localhost", rigs: Sequence[str] = RIGS) -> None:
        self.folder = folder
        self.made = certificates(folder)
        for rig in rigs[1:]:
            pki.issue_to_rig(self.made, rig, [])
        pki.issue_to_router(self.made, [host])
        self.endpoint = f"tls/{host}:{free_port()}"

    def access(self, rig: str) -> str:
        """Return [access] of a rig's configuration."""
        return (
            f'[rig]\nid = "{rig}"\n[access]\nrouter = "{self.endpoint}"\n'
            f'certificate = "{self.made}/rig-{rig}.pem"\n'
        )

    def router_command(self) -> list[str]:
        """Return the arguments of `armrig` that are the router."""
        files = self.made / "router.pem", self.made / pki.ACCESS_LIST
        given = [
            f"--{name}={file}" for name, file in zip(("certificate", "names"), files, strict=True)
        ]
        return ["router", "--listen", self.endpoint, *given]

    def alice(self) -> Rig:
        """Return a client of rig 1 at the router, that may drive it."""
        return Rig("1", connect=self.endpoint, certificate=self.made / "alice.pem")

    def serve(self, bench: Bench) -> Process:
        """Start a router and the daemon of rig 1; return the router, once it reaches the rig."""
        bench.configure(more=self.access("1"))
        bench.emulate()
        router = bench.start("armrig", *self.router_command())
        bench.serve()
        wait_for(self._reaches_the_rig)
        return router

    def _reaches_the_rig(self) -> bool:
        with suppress(RuntimeError), self.alice() as rig:
            return rig.status().phase == "safe"
        return False

    def router(self) -> zenoh.Session:
        """Return a router that is open in this process."""
        files = self.made / "router.pem", self.made / pki.ACCESS_LIST
        return open_router(self.endpoint, *files)[0]

    @contextmanager
    def daemon(self, rig: str) -> Iterator[Session]:
        """Give a daemon's session that is connected to the router, or will be."""
        access = Access(router=self.endpoint, certificate=str(self.made / f"rig-{rig}.pem"))
        ways = networks_of(Config(rig=RigTable(id=rig), access=access))
        where = f"unixsock-stream/{self.folder}/{rig}.sock"
        with Session(where, rig, lambda: None, *ways) as session:
            yield session

    def recorder(
        self, tell: Callable[[str], None], tell_error: Callable[[str], None] | None = None
    ) -> Recorder:
        """Return one recorder of all."""
        return Recorder(self, tell, tell_error or tell)


def recorded_k(path: Path) -> list[int]:
    """Return the indices of the samples in a file."""
    return [int(k) for k in armrig.load(path).samples["k"]]


def connected(*daemons: Session) -> None:
    """Wait until daemons have found their router."""
    wait_for(lambda: all(d.uplink is not None and d.uplink.has_router for d in daemons), WITHIN_S)


class Publisher:
    """Publishes samples of all daemons, in a thread, in a `with` block."""

    def __init__(self, *daemons: Session) -> None:
        self.daemons = daemons
        self.k = 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._publish)

    def __enter__(self) -> Publisher:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def wait_for_more(self, samples: int) -> None:
        """Wait until so many more were published."""
        until = self.k + samples
        wait_for(lambda: self.k >= until, WITHIN_S)

    def _publish(self) -> None:
        while not self._over.wait(TS_S):
            publish(self.daemons, range(self.k, self.k + 1))
            self.k += 1


def publish(daemons: Sequence[Session], ks: range) -> None:
    """Publish these samples of each, and its state now and then."""
    for k in ks:
        for daemon in daemons:
            if k % 50 == 0:
                daemon.put("state", state(k))
            daemon.put("sample", sample(k))


class Recorder:
    """`armrig record --all` in a thread, in a `with` block."""

    def __init__(
        self, lab: FleetLab, tell: Callable[[str], None], tell_error: Callable[[str], None]
    ) -> None:
        self.folder = lab.folder / "files"
        self.folder.mkdir()
        self.recorded: dict[str, RigRecorded] = {}
        self._stack = ExitStack()
        session = self._stack.enter_context(open_endpoint(lab.endpoint).session)
        self._fleet = FleetRecorder(session, lab.endpoint, self.path_of, tell, tell_error)
        self.paths: dict[str, Path] = {}
        """Rigs whose files go elsewhere."""
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._record)

    def __enter__(self) -> Recorder:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._stack.close()

    def path_of(self, rig: str) -> Path:
        """Return the path of a rig's first file."""
        return self.paths.get(rig, self.folder / f"{rig}.mcap")

    def has_begun(self, *rigs: str) -> None:
        """Wait until there is a file of each of these."""
        there = [self.folder / f"{rig}.mcap.active" for rig in rigs]
        wait_for(lambda: all(path.exists() for path in there), WITHIN_S)

    def _record(self) -> None:
        found = self._fleet.record(self._ended, None, None)
        self.recorded = {one.rig: one for one in found}
