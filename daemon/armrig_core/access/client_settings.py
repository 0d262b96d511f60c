"""Settings by which a client finds its daemon, from the table `[client]` and the environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from armrig_core.access.endpoint import resolve_paths
from armrig_core.errors import FileError, InputError
from armrig_core.process.bounded import CONFIGURATION_LIMIT
from armrig_core.process.toml_file import TomlTable, convert, read_toml

_PREFIX = "ARMRIG_CLIENT_"


class ClientSettings(TomlTable, frozen=True, kw_only=True):
    """`[client]`: the daemon to which `armrig` connects; the daemon itself ignores this table."""

    connect: str = ""
    """Endpoint of the daemon, such as tls/lab-1.example.edu:7447; default: the local daemon."""
    certificate: str = ""
    """File with your key and certificates for tls/, from `armrig pki operator` or `observer`."""


def client_settings(paths: Sequence[Path], environ: Mapping[str, str]) -> ClientSettings:
    """Return the settings in the given files and environment variables.

    A later file of `paths` overrides an earlier one. A file that this user may not read, such as
    the daemon's file, is ignored. Variables of `environ` that begin with `ARMRIG_CLIENT_` override
    the files.

    Raises ValueError if a file is not TOML, or its table has an unknown key or a value that is not
    text.
    """
    settings: dict[str, str] = {}
    for path in paths:
        settings |= _client_table(_table(path), path.absolute().parent, str(path))
    variables = {
        key.removeprefix(_PREFIX).lower(): value
        for key, value in environ.items()
        if key.startswith(_PREFIX)
    }
    settings |= _client_table(variables, Path.cwd(), "environment")
    return ClientSettings(**settings)


def _table(path: Path) -> Any:
    try:
        tables = read_toml(path, CONFIGURATION_LIMIT)
    except FileError as err:
        if isinstance(err.__cause__, PermissionError):
            return {}
        raise
    return tables.get("client", {})


class _ClientFile(msgspec.Struct, frozen=True, kw_only=True):
    client: ClientSettings


def _client_table(table: Any, directory: Path, where: str) -> dict[str, str]:
    tables = resolve_paths({"client": table}, directory)
    try:
        convert(tables, _ClientFile)
    except InputError as err:
        raise InputError(f"{where}: {err}") from err
    return dict(tables["client"])
