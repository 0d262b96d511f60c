"""A client without an endpoint uses only a socket that no other user can have made."""

from __future__ import annotations

import os
import socket
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path, PurePosixPath

import armrig
import pytest
from armrig.cli import main
from armrig.rig import session
from armrig.rig.client import Rig
from armrig.rig.session import NoReplyError, RigError
from armrig.rig.status import live_rigs
from armrig_core.access import daemon_lock
from armrig_core.access.endpoint import endpoint
from armrig_core.telemetry.topics import PLAYED

from tests.clients.fake_daemon import FakeDaemon
from tests.clients.rig.conftest import SERVICE_UID

# Most of these tests give a directory to another user.
pytestmark = pytest.mark.root
NOBODY = 65534


@pytest.fixture
def directory(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Give the directory where a daemon of this user would listen, with one in it that answers."""
    with tempfile.TemporaryDirectory(prefix="armrig-") as temporary:
        monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
        monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
        monkeypatch.setattr(tempfile, "tempdir", temporary)
        found = Path(temporary) / f"armrig-{os.getuid()}"
        found.mkdir(mode=0o700)
        with FakeDaemon(endpoint("1", found)):
            yield found


def _chmod(directory: Path) -> None:
    directory.chmod(0o777)


def _link(directory: Path) -> None:
    directory.rename(directory.with_name("elsewhere"))
    directory.symlink_to("elsewhere")


def _chown(directory: Path) -> None:
    if os.getuid() != 0:
        pytest.skip("only root can give a directory to another user")
    os.chown(directory, NOBODY, NOBODY)


def test_a_private_directory_is_used_unless_an_endpoint_is_configured(
    directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Rig() as rig:
        ours = rig.endpoint
        assert rig.status().rig == "1"
    monkeypatch.setenv("ARMRIG_CLIENT_CONNECT", "tcp/lab:7447")

    assert ours == str(endpoint("1", PurePosixPath(directory)))
    assert Rig().endpoint == "tcp/lab:7447"


@pytest.mark.parametrize(
    ("spoil", "wrong"),
    [
        (_chown, r"belongs to another user \(uid 65534\)"),
        (_chmod, r"can be written by other users \(mode 777, not 700\)"),
        (_link, "is a symbolic link"),
    ],
)
def test_a_directory_writable_by_another_user_is_refused(
    directory: Path,
    spoil: Callable[[Path], None],
    wrong: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    spoil(directory)

    with pytest.raises(RigError, match=wrong), Rig():
        pass
    with pytest.raises(RigError, match=wrong):
        next(armrig.stream("rig/1/sample"))
    for command in ("status", "stop", "reset"):
        assert main([command]) == 1
        told = capsys.readouterr()
        assert told.out == ""
        assert "set XDG_RUNTIME_DIR to a directory of yours" in told.err
        assert "--connect" in told.err


def test_an_explicit_endpoint_is_not_checked(directory: Path) -> None:
    directory.chmod(0o777)

    with Rig(connect=endpoint("1", directory)) as rig:
        assert rig.status().rig == "1"


def test_a_missing_directory_is_reported_as_no_rig(directory: Path) -> None:
    directory.rename(directory.with_name("elsewhere"))

    missing = "no rig runs here; in another terminal: `armrig lab`"
    with pytest.raises(NoReplyError, match=missing), Rig():
        pass


@pytest.fixture
def service(services: Path) -> Iterator[Path]:
    """Give the folder of a rig's service on a machine where its user runs it, with one in it."""
    if os.getuid() != 0:
        pytest.skip("only root can give a directory to another user")
    os.chown(services / "1", SERVICE_UID, SERVICE_UID)
    with FakeDaemon(endpoint("1", services / "1")):
        yield services / "1"


def test_the_service_of_this_machine_is_found(service: Path) -> None:
    for owner in (SERVICE_UID, 0):
        os.chown(service, owner, owner)
        with Rig() as rig:
            assert rig.status().rig == "1"
            assert rig.endpoint == endpoint("1", service)


def test_the_daemon_of_the_user_precedes_the_service(service: Path) -> None:
    own = Path(os.environ["XDG_RUNTIME_DIR"]) / "armrig"
    own.mkdir(mode=0o700)
    with FakeDaemon(endpoint("1", own)) as daemon, Rig() as rig:
        assert rig.endpoint == daemon.endpoint
    with socket.socket(socket.AF_UNIX) as left_over:
        left_over.bind(str(own / "1.sock"))

    with Rig() as rig:
        assert rig.endpoint == endpoint("1", service)


@pytest.mark.parametrize("above", [False, True])
@pytest.mark.parametrize(
    ("spoil", "wrong"),
    [
        (lambda path: os.chown(path, NOBODY, NOBODY), "belongs to another user"),
        (lambda path: path.chmod(0o770), "can be written by other users"),
    ],
)
def test_a_service_folder_writable_by_another_user_is_refused(
    service: Path, spoil: Callable[[Path], None], wrong: str, above: bool
) -> None:
    spoil(service.parent if above else service)

    with pytest.raises(RigError, match=wrong), Rig():
        pass


@pytest.mark.parametrize(("user", "uids"), [("nobody", {NOBODY}), ("nobody-here", set())])
def test_a_service_folder_may_belong_to_root_or_the_service_user(
    user: str, uids: set[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert daemon_lock.SERVICE_USER == "armrig"
    monkeypatch.setattr(daemon_lock, "SERVICE_USER", user)

    assert daemon_lock.service_owners() == {0} | uids


def test_a_user_outside_the_group_gets_the_reason(
    service: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session.os, "access", lambda path, mode: False)

    with pytest.raises(RigError, match="only the group armrig may operate rig 1: `sudo usermod"):
        Rig().__enter__()


def test_the_rigs_of_this_machine_do_not_include_played_recordings(
    service: Path,
) -> None:
    own = Path(session._socket_directory())
    own.mkdir(exist_ok=True)
    for name in ("lab-2.sock", f"{PLAYED}a.sock", "Not an id.sock", "b.socket"):
        (own / name).touch()
    (service / "lab-1.sock").touch()

    assert session.local_rigs() == ["1", "lab-1", "lab-2"]


def test_a_rig_without_its_daemon_is_listed_with_the_reason(directory: Path) -> None:
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(directory / "0.sock"))

    where, (gone, there) = live_rigs(None)

    assert where == "this machine"
    assert (there.rig, there.status is not None, there.why) == ("1", True, "")
    assert (gone.rig, gone.status) == ("0", None)
    assert gone.why.startswith("no rig 0 runs here; ")
