"""Recordings of the arm, which the tests of the clients share."""

from __future__ import annotations

import io
import pkgutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path, PurePosixPath
from threading import TIMEOUT_MAX

import armrig
import pytest
from armrig.cli import printing
from armrig_core.access.endpoint import endpoint

from tests.clients.fake_daemon import FakeDaemon
from tests.clients.handout_plant import plant, reference

__all__ = ["plant", "reference"]


@pytest.fixture(scope="session", autouse=True)
def every_module_is_loaded() -> None:
    """Load all modules: a module first loaded during a patch would keep the patched function."""
    for module in pkgutil.walk_packages(armrig.__path__, "armrig."):
        if not module.name.endswith("__main__"):
            import_module(module.name)


@pytest.fixture(scope="session", autouse=True)
def no_line_of_progress() -> None:
    """Print no progress into stored texts on a slow machine."""
    printing.PROGRESS_INTERVAL_S = TIMEOUT_MAX


@pytest.fixture(autouse=True)
def no_figure_stays_open() -> Iterator[None]:
    """Close the figures that a test has drawn into windows."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch) -> Callable[[str | None], None]:
    """Give a function that has a text typed at a terminal; None: there is no terminal."""

    def types(text: str | None) -> None:
        monkeypatch.setattr(sys, "stdin", io.StringIO() if text is None else _Terminal(text))

    return types


@pytest.fixture
def where() -> Iterator[str]:
    """Give an endpoint; not pytest's own directory, whose path may be too long for a socket."""
    with tempfile.TemporaryDirectory(prefix="armrig-") as directory:
        yield endpoint("1", PurePosixPath(directory))


@pytest.fixture
def daemon(where: str) -> Iterator[FakeDaemon]:
    """Give a daemon that answers at the endpoint."""
    with FakeDaemon(where) as running:
        yield running


@pytest.fixture(scope="session")
def three_recordings(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Give a step, a telegraph and another one with a gap, of the handout's arm."""
    from armrig.excitation import step, telegraph

    from tests.clients.made_recordings import of_the_arm, written

    directory = tmp_path_factory.mktemp("recordings")
    inputs = (
        ("step", step(200, at=50), "step", 1, None),
        ("estimation", telegraph(1500, 0.05, seed=1), "blackbox", 1, None),
        ("validation", telegraph(1200, 0.05, seed=2), "blackbox", 2, slice(600, 605)),
    )
    a, b, c = (
        written(directory, of_the_arm(u, experiment=e, seed=s, missing=m), f"{name}.mcap")
        for name, u, e, s, m in inputs
    )
    return a, b, c
