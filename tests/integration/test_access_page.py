"""docs/access.md: every command and every configuration in it, on a real daemon."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from pwd import getpwnam

import pytest
from armrig.cli import main

from tests.integration.laboratory import free_port
from tests.integration.processes import Bench, wait_for

PAGE = (Path(__file__).parents[2] / "docs" / "access.md").read_text(encoding="utf-8")
HOST, ROUTER_HOST = "lab-1.example.edu", "lab.example.edu"


def _blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def _here(text: str, port: int) -> str:
    """Return the page's text, for a rig on this machine."""
    return (
        text.replace("0.0.0.0:7447", f"127.0.0.1:{port}")
        .replace(HOST, "localhost")
        .replace(":7447", f":{port}")
    )


def _commands(block: str) -> list[list[str]]:
    return [shlex.split(line)[1:] for line in block.splitlines()]


ACCESS, CLIENT, ACCESS_BY_ROUTER = _blocks("toml")
# The others: tests/systemd/test_walk.py.
INSTALL, MADE, PUT, _, _, USED, CHANGED, MADE_FOR_ROUTER, _, ROUTER, LOOKED = _blocks("sh")


@pytest.fixture
def lab(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> Bench:
    """Give a bench in whose folder the page's authority was made."""
    monkeypatch.chdir(bench.folder)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(bench.folder / "config"))
    for command in _commands(MADE):
        assert main([part.replace(HOST, "localhost") for part in command]) == 0
    return bench


def _serve(lab: Bench, access: str, port: int) -> None:
    for name in ("rig-1.pem", "access.toml"):
        (lab.folder / "pki" / name).rename(lab.folder / name)
    lab.configure(watchdog_ms=250, more=_here(access, port))
    lab.emulate()
    lab.serve()


def _client(lab: Bench, table: str, port: int) -> None:
    folder = lab.folder / "config" / "armrig"
    folder.mkdir(parents=True)
    (folder / "armrig.toml").write_text(_here(table, port))


def _armrig(lab: Bench, *arguments: str, **env: str) -> subprocess.CompletedProcess[str]:
    """Run a command as a user without a daemon."""
    environ = {**os.environ, "XDG_RUNTIME_DIR": str(lab.folder / "nowhere"), **env}
    return subprocess.run(
        [sys.executable, "-m", "armrig", *arguments],
        env=environ,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.exhaustive
def test_the_page_leads_to_a_recording_over_the_network(lab: Bench) -> None:
    port = free_port()
    _serve(lab, ACCESS, port)
    _client(lab, CLIENT, port)
    credential = lab.folder / "config" / "armrig" / "alice.pem"
    (lab.folder / "pki" / "alice.pem").rename(credential)

    for command in _commands(USED):
        done = _armrig(lab, *command)
        assert done.returncode == 0, done.stderr

    (once,) = re.findall(r"`ARMRIG_CLIENT_CERTIFICATE=alice.pem armrig (.*?)`", PAGE)
    (lab.folder / "config" / "armrig" / "armrig.toml").unlink()
    done = _armrig(lab, *_here(once, port).split(), ARMRIG_CLIENT_CERTIFICATE=str(credential))
    assert done.returncode == 0, done.stderr

    (program,) = _blocks("python")
    asked = subprocess.run(
        [sys.executable, "-c", _here(program, port)],
        cwd=credential.parent,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert asked.stdout.strip() in ("safe", "fault")


@pytest.mark.exhaustive
def test_the_page_leads_to_a_rig_behind_a_router(
    lab: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = free_port()
    for command in _commands(MADE_FOR_ROUTER):
        assert main([part.replace(ROUTER_HOST, "localhost") for part in command]) == 0
    for path in (lab.folder / "pki").iterdir():
        path.rename(lab.folder / path.name)
    lab.configure(watchdog_ms=250, more=_at_router(f'[rig]\nid = "2"\n{ACCESS_BY_ROUTER}', port))
    lab.emulate()
    lab.start("armrig_daemon", "run", "--config", str(lab.config))
    (router,) = _commands(_here(ROUTER, port))
    lab.start("armrig", *router)
    monkeypatch.setenv("ARMRIG_CLIENT_CERTIFICATE", str(lab.folder / "alice.pem"))
    listing, status = _commands(_at_router(LOOKED, port))

    wait_for(lambda: "safe" in _armrig(lab, *listing).stdout, 60)
    done = _armrig(lab, *status)

    assert done.returncode == 0, done.stderr
    assert "rig          2, armrig" in done.stdout
    router_log = lab.processes[-1]
    wait_for(lambda: ": 2 rigs, 1 may drive and 1 may watch" in router_log.said)
    assert "router at tls/127.0.0.1:" in router_log.said


def _at_router(text: str, port: int) -> str:
    return text.replace(ROUTER_HOST, "localhost").replace(":7447", f":{port}")


@pytest.mark.root
@pytest.mark.skipif(os.geteuid() != 0, reason="only root installs files for another user")
def test_the_page_protects_keys_from_students(lab: Bench) -> None:
    owner, folder = getpwnam("daemon"), lab.folder / "etc"
    student = {"user": 65534, "group": 65534, "extra_groups": [owner.pw_gid]}
    folder.mkdir()
    folder.chmod(0o755)

    for line in PUT.splitlines():
        typed = line.replace("/etc/armrig/", str(folder)).replace("armrig ", "daemon ")
        subprocess.run(shlex.split(typed), cwd=lab.folder / "pki", check=True)
    read = {
        path.name: subprocess.run(
            ["cat", path.name], cwd=folder, **student, capture_output=True, check=False
        ).stdout
        for path in folder.iterdir()
    }

    assert read.pop("access.toml").startswith(b"#")
    assert read == {"rig-1.pem": b""}


def test_the_page_leads_to_renewal_and_revocation_of_certificates(
    lab: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in _commands(CHANGED):
        assert main(command) == 0
    capsys.readouterr()
    assert main(["pki", "list"]) == 0

    roles = dict(line.split()[:2] for line in capsys.readouterr().out.splitlines())
    assert roles == {
        "alice": "revoked",
        "alice-2": "operators",
        "bob": "observers",
        "rig-1": "rig",
    }
