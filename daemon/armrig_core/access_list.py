"""Who may do what, by name: a TOML that `armrig pki` keeps and the daemon reads at its start."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from armrig_core.credential import RIG_PREFIX, check_name
from armrig_core.errors import FileError, InputError
from armrig_core.toml_file import read_toml

LIMIT = 1 << 20
"""Longest access list, in B."""
_HEADING = """\
# Who may do what with the rigs, by the name in the certificate (or of the user with a password).
# `armrig pki` writes it; armrigd and `armrig router` read it at their start: start them anew after
# each change.
"""

_Names = Annotated[tuple[str, ...], Meta(max_length=10_000)]


class AccessList(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Names, each in one list at most; whoever is in none of the first three may do nothing."""

    operators: _Names = ()
    """Who may drive the rigs, and watch."""
    observers: _Names = ()
    """Who may watch."""
    rigs: _Names = ()
    """Names in the rigs' certificates, such as rig-1: each may be that rig at a router."""
    revoked: _Names = ()
    """Who may do nothing any more, and whose name is not given again."""

    def __post_init__(self) -> None:
        """Refuse what is no name, and a name that stands twice."""
        seen: set[str] = set()
        for name in (*self.operators, *self.observers, *self.rigs, *self.revoked):
            if check_name(name) in seen:
                raise InputError(f"{name!r} stands there twice: once is allowed")
            seen.add(name)
        for name in self.rigs:
            if not name.startswith(RIG_PREFIX):
                msg = f"{name!r} among the rigs: the name in a rig's certificate is needed, such "
                raise InputError(f"{msg}as {RIG_PREFIX}1")

    def role(self, name: str) -> str:
        """Return the list that a name stands in; "" where it is in none."""
        return next((role for role in self.__struct_fields__ if name in getattr(self, role)), "")

    def with_name(self, name: str, role: str) -> AccessList:
        """Return the list with a name in `role`, and in no other."""
        fields = {
            field: tuple(n for n in getattr(self, field) if n != name)
            for field in self.__struct_fields__
        }
        return AccessList(**{**fields, role: (*fields[role], name)})

    def toml(self) -> str:
        """Return the text of its file."""
        rows = [f"{f} = {json.dumps(getattr(self, f))}\n" for f in self.__struct_fields__]
        return _HEADING + "".join(rows)


def read_access_list(path: Path) -> AccessList:
    """Return the access list in a file.

    Raises
    ------
    FileError
        It cannot be read, is no TOML, or holds a key or a name that is not allowed.
    """
    try:
        return msgspec.convert(read_toml(path, LIMIT), AccessList)
    except FileNotFoundError as err:
        raise FileError(f"{path}: there is no such file; `armrig pki ca` writes one") from err
    except OSError as err:
        raise FileError(
            f"{path}: {err.strerror}; it must be a file that this user may read"
        ) from err
    except ValueError as err:
        raise FileError(f"{path}: {err}") from err
