"""Admission of commands: the service refuses a command before it reads the content."""

from __future__ import annotations

import msgspec
import pytest
from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import REQUESTS, Renew, RunRequest, SetRequest
from armrig_core.rig.calibration_file import RAW_LIMIT
from armrig_daemon.service.admission import LEASED, refusal

LEASE = "0123456789abcdef" * 2
OTHER = "f" * 32


@pytest.mark.parametrize("name", sorted(LEASED))
@pytest.mark.parametrize("lease", [LEASE, ""])
def test_a_command_without_the_lease_in_force_is_refused(name: str, lease: str) -> None:
    for payload in (b'{"lease": "%s", "n": 1}' % OTHER.encode(), b"", b"\xff" * 10_000):
        found = refusal(name, payload, lease.encode())
        assert found is not None
        assert found.error == "not the lease in force: arm first"
        assert (found.code, found.passes) == (RefusalCode.NOT_HELD, False)


@pytest.mark.parametrize(
    "request_",
    [
        RunRequest(lease=LEASE, n=1, u=[1.0] * 10_000),
        SetRequest(lease=LEASE, n=1, u=1.0),
        Renew(lease=LEASE, n=1),
    ],
)
def test_commands_of_the_holder_are_admitted(request_: RunRequest | SetRequest | Renew) -> None:
    assert refusal(request_.name, msgspec.json.encode(request_), LEASE.encode()) is None


@pytest.mark.parametrize("name", sorted({*REQUESTS, "explode"} - {"run", "control", "calibrate"}))
def test_commands_except_runs_and_calibrate_have_at_most_4096_bytes(name: str) -> None:
    """The longest sensible command has a hundred bytes."""
    payload = LEASE.encode().ljust(4096)

    assert refusal(name, payload, LEASE.encode()) is None
    found = refusal(name, payload + b" ", LEASE.encode())
    assert found is not None
    assert found.error == f"{name}: 4097 B, at most 4096 B are allowed"
    assert found.parameters == {"bytes": 4097, "most_bytes": 4096}


@pytest.mark.parametrize("name", ["arm", "status", "stop", "reset", "explode"])
def test_commands_without_a_lease_are_admitted(name: str) -> None:
    assert refusal(name, b"", b"") is None
    assert refusal(name, b"{}", LEASE.encode()) is None


def test_the_size_limit_of_a_calibration_includes_its_samples() -> None:
    """R1: 1 MiB of them in base64, and 64 KiB for the rest."""
    longest = msgspec.json.encode(bytes(RAW_LIMIT))[2:] + bytes(1 << 16)

    assert refusal("calibrate", longest, b"") is None
    found = refusal("calibrate", longest + b" ", b"")
    assert found is not None
    assert found.error == (f"calibrate: {len(longest) + 1} B, at most {len(longest)} B are allowed")
