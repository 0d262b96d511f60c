"""Permissions by name: a TOML file that `armrig pki` writes and the daemon reads at its start."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from armrig_core.access.credential import RIG_PREFIX, check_name
from armrig_core.errors import FileError, InputError
from armrig_core.process.bounded import read_text
from armrig_core.process.toml_file import toml_tables

LIMIT = 1 << 20
"""Longest access list, in B."""
_HEADING = """\
# Permissions at the rigs, by the name in the certificate.
# `armrig pki` writes this file; armrigd and `armrig router` read it at their start: restart them
# after each change.
"""

_Names = Annotated[tuple[str, ...], Meta(max_length=10_000)]


class AccessList(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Lists of distinct names; only operators, observers and rigs have permissions."""

    operators: _Names = ()
    """Names of clients that may drive and watch the rigs."""
    observers: _Names = ()
    """Names of clients that may watch the rigs."""
    rigs: _Names = ()
    """Names in the rigs' certificates; the certificate of rig 1 contains the name rig-1."""
    revoked: _Names = ()
    """Names whose permissions were removed; no new certificate contains a revoked name."""

    def __post_init__(self) -> None:
        """Refuse malformed names, names listed twice, and rigs' names without `RIG_PREFIX`."""
        seen: set[str] = set()
        for name in (*self.operators, *self.observers, *self.rigs, *self.revoked):
            if check_name(name) in seen:
                raise InputError(f"{name!r} is listed twice; once is allowed")
            seen.add(name)
        for name in self.rigs:
            if not name.startswith(RIG_PREFIX):
                msg = f"rigs contains {name!r}; allowed are names of rigs' certificates, such as "
                raise InputError(f"{msg}{RIG_PREFIX}1")

    def role(self, name: str) -> str:
        """Return the field that lists `name`, such as "operators"; "" if no field lists it."""
        return next((role for role in self.__struct_fields__ if name in getattr(self, role)), "")

    def with_name(self, name: str, role: str) -> AccessList:
        """Return the access list with `name` in the list `role`, and in no other list."""
        fields = {
            field: tuple(n for n in getattr(self, field) if n != name)
            for field in self.__struct_fields__
        }
        return AccessList(**{**fields, role: (*fields[role], name)})

    def toml(self) -> str:
        """Return the access list as the text of a TOML file."""
        rows = [f"{f} = {json.dumps(getattr(self, f))}\n" for f in self.__struct_fields__]
        return _HEADING + "".join(rows)


def read_access_list(path: Path) -> AccessList:
    """Return the access list in a file.

    Raises FileError if the file cannot be read, is not TOML, or contains a key or a name that is
    not allowed.
    """
    try:
        return msgspec.convert(toml_tables(read_text(path, LIMIT)), AccessList)
    except FileNotFoundError as err:
        raise FileError(f"{path}: there is no such file; `armrig pki ca` writes one") from err
    except OSError as err:
        raise FileError(f"{path}: {err.strerror}; choose a file that this user may read") from err
    except ValueError as err:
        raise FileError(f"{path}: {err}") from err
