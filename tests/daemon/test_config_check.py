"""`armrigd config --check` reports of a file what the daemon would report at its start."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig.lab import pki
from armrig_core.rig.description import path_of
from armrig_daemon.command_line import app
from armrig_daemon.config import EX_CONFIG
from typer.testing import CliRunner

OVER_TLS = (
    '[access]\nlisten = "tls/0.0.0.0:7447"\ncertificate = "rig-2.pem"\nnames = "access.toml"\n'
)


def _armrigd(*arguments: str | Path) -> tuple[int, str]:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    return done.exit_code, done.output


@pytest.fixture
def machine(machine: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give the folder of the machine's configurations; the shell has a variable of its own."""
    monkeypatch.setenv("ARMRIG_LIMITS_U_MAX_V", "2")
    return machine


def test_a_valid_configuration_file_is_reported_in_one_line(tmp_path: Path) -> None:
    pki.make_authority(tmp_path)
    pki.issue_to_rig(tmp_path, "2", ["localhost"])
    pki.issue_to_person(tmp_path, "alice", "operators")
    file = tmp_path / "new.toml"
    file.write_text(f'[rig]\nid = "2"\n[device]\nport = "/dev/ttyACM7"\n{OVER_TLS}')

    code, said = _armrigd("config", "--check", file)

    assert code == 0, said
    assert said.startswith(f"{file}: rig 2, port /dev/ttyACM7 at 500000 baud, 0 to 5 V; also at ")
    assert "also at tls/0.0.0.0:7447: 1 may drive and 0 may watch, by certificate" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[limits]\nu_max_v = 6\n", "limits.u_max_v = 6: expected `float` <= 5.0"),
        (
            f'[rig]\nfile = "{path_of(Path("optoshield"))}"\n[limits]\nu_max_v = 5\n',
            "limits.u_max_v = 5: expected at most 1.25, as input.u_max_v in the description of rig",
        ),
        ("[limits]\nu_max_v = 4\nu_max_v = 4\n", "line 3: u_max_v = 4: given twice"),
        ("[device]\nprot = 1\n", "device.prot = 1: no such key"),
        ('[recording]\ndirectory = "~nobody-of-that-name/x"\n', "there is no such user"),
        ('[calibration]\nfile = "none.toml"\n', "calibration.file = 'none.toml'"),
    ],
)
def test_the_check_refuses_a_file_with_the_message_of_the_daemon(
    tmp_path: Path, text: str, says: str
) -> None:
    file = tmp_path / "new.toml"
    file.write_text(text)

    checked = _armrigd("config", "--check", file)

    assert checked == _armrigd("run", "--config", file)
    assert checked[0] == EX_CONFIG
    assert says in checked[1]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (OVER_TLS, "access.toml: there is no such file; `armrig pki ca` writes one"),
        ('[access]\nnames = "access.toml"\n', "[access] names is given, but listen is not"),
    ],
)
def test_the_check_includes_the_files_of_the_access_control(
    tmp_path: Path, text: str, says: str
) -> None:
    file = tmp_path / "new.toml"
    file.write_text(text)

    code, said = _armrigd("config", "--check", file)

    assert (code, said.count("\n")) == (EX_CONFIG, 1)
    assert says in said


def test_the_check_reads_the_file_of_a_rig_like_its_service(machine: Path) -> None:
    (machine / "armrig.toml").write_text("[limits]\nu_max_v = 4.5\n")
    (machine / "2.toml").write_text("[limits]\nu_min_v = 1\n")
    (machine / "3.toml").write_text('[rig]\nid = "2"\n')

    assert (
        "rig 2, port /dev/armrig at 500000 baud, 1 to 4.5 V"
        in _armrigd("config", "--check", machine / "2.toml")[1]
    )
    code, said = _armrigd("config", "--check", machine / "3.toml")
    assert (code, "the file belongs to rig '3'" in said) == (EX_CONFIG, True)


def test_the_check_reads_the_common_file_of_all_rigs_like_any_file(machine: Path) -> None:
    (machine / "armrig.toml").write_text("[limits]\nu_min_v = 0.5\nu_max_v = 4.5\n")

    code, said = _armrigd("config", "--check", machine / "armrig.toml")

    assert (code, "rig 1, port /dev/armrig at 500000 baud, 0.5 to 2 V" in said) == (0, True)
