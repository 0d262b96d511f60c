"""Limits that the system sets to this process: address space and open files."""

from __future__ import annotations

import resource
from contextlib import suppress

from armrig_core.errors import OperationError

MIB = 1 << 20


def require(program: str, *, memory_mib: int, files: int) -> None:
    """Raise OperationError if the limits of this process are too low for a program.

    Must be called before zenoh and numpy are imported, because both end or block the process if the
    memory is too small. A soft limit on open files is raised as far as necessary. A program that
    stops the motor never calls this function.

    Parameters
    ----------
    memory_mib : int
        Address space that the program needs, in MiB. A thread reserves 64 MiB.
    files : int
        Number of files that the program opens.
    """
    space, _ = resource.getrlimit(resource.RLIMIT_AS)
    if space != resource.RLIM_INFINITY and space < memory_mib * MIB:
        raise OperationError(
            f"the address space is limited to {space // MIB} MiB, {program} needs {memory_mib} "
            "MiB: begin in a shell without `ulimit -v`, or remove LimitAS= from the unit"
        )
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= files:
        return
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (files, hard))
        return
    raise OperationError(
        f"open files are limited to {hard}, {program} needs {files}: begin in a shell with "
        f"`ulimit -n {files}` or more, or set LimitNOFILE= in the unit"
    )
