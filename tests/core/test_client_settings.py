"""Settings of a client: files, over which the environment has precedence."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig_core.access.client_settings import ClientSettings, client_settings
from armrig_core.process import toml_file


def _file(path: Path, text: str) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)
    return path


def test_the_environment_overrides_the_later_file_and_it_the_earlier(tmp_path: Path) -> None:
    first = _file(tmp_path / "a", '[client]\nconnect = "tls/a:1"\ncertificate = "/a.pem"')
    second = _file(tmp_path / "b", '[client]\nconnect = "tls/b:1"\n[rig]\nid = "1"')

    assert client_settings([], {}) == ClientSettings()
    assert client_settings([first, second], {}) == ClientSettings(
        connect="tls/b:1", certificate="/a.pem"
    )
    assert client_settings([first], {"ARMRIG_CLIENT_CONNECT": "tls/c:1"}).connect == "tls/c:1"


def test_a_credential_path_is_relative_to_the_file_that_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = _file(tmp_path / "x" / "a", '[client]\ncertificate = "~/alice.pem"')
    monkeypatch.setenv("HOME", "/home/alice")
    monkeypatch.chdir(tmp_path)

    assert client_settings([path], {}).certificate == "/home/alice/alice.pem"
    path.write_text('[client]\ncertificate = "alice.pem"')
    assert client_settings([path], {}).certificate == str(tmp_path / "x" / "alice.pem")
    given = client_settings([], {"ARMRIG_CLIENT_CERTIFICATE": "alice.pem"})
    assert given.certificate == str(tmp_path / "alice.pem")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[client]\nconect = ''", "no such key; allowed are connect, certificate"),
        ("[client]\nconnect = 1", "client.connect = 1: expected `str`, got `int`"),
        ("client = 1", "client = 1: must be a table"),
        ("[client", "not a TOML file"),
    ],
)
def test_a_forbidden_setting_is_refused(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(ValueError, match=rf"armrig.toml: .*{says}"):
        client_settings([_file(tmp_path / "armrig.toml", text)], {})


def test_an_unreadable_file_of_the_daemon_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, most: int) -> str:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(toml_file, "read_text", refuse)

    assert client_settings([Path("/etc/armrig/1.toml")], {}) == ClientSettings()
