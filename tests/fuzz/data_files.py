"""The reader of other data: any file gives a Dataset, or one line with the reason."""

from __future__ import annotations

import tempfile
from collections import Counter
from io import BytesIO
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from armrig.data.files.loading import load_data
from armrig_core.errors import FileError
from scipy.io import savemat

from tests.fuzz.files import in_memory, in_one_line
from tests.fuzz.mutation import mutated

N = 30
_LONGEST = 400  # characters that one or two lines have


def corpus() -> list[tuple[str, bytes]]:
    """Return a file of each kind and its suffix."""
    u, y = np.random.default_rng(1).standard_normal((2, N))
    fields: dict[str, Any] = {"u": u, "y": y.astype(np.float32), "Ts": 0.5, "note": "heater"}
    rows = "".join(
        f"{k};{a!r};{b!r}\r\n" for k, (a, b) in enumerate(zip(u.tolist(), y.tolist(), strict=True))
    )
    text = f"# made\nt [s];u [V];y\n{rows}"
    packed, plain = (_mat(fields | {"z": fields}, do_compression=way) for way in (True, False))
    arrays = BytesIO()
    np.savez_compressed(arrays, u=u, y=y)
    return [
        (".csv", text.encode()),
        (".csv", text.replace(".", ",").encode()),
        (".mat", plain),
        (".mat", packed),
        (".mat", _mat(fields, format="4")),
        (".npz", arrays.getvalue()),
    ]


def _mat(values: dict[str, Any], **how: Any) -> bytes:
    out = BytesIO()
    savemat(out, values, **how)
    return out.getvalue()


def _short(err: FileError, path: Path) -> None:
    """Assert that a person can read it at once."""
    in_one_line(err)
    assert len(str(err)) - len(str(path)) < _LONGEST, str(err)


def fuzz(most: int, seed: int) -> Counter[str]:
    """Read `most` files; return how many gave data, and how many none."""
    rng, files = Random(seed), corpus()
    pieces = [data for _, data in files]
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="armrig-fuzz-", dir=in_memory()) as directory:
        for _ in range(most):
            suffix, data = rng.choice(files)
            path = Path(directory) / f"data{suffix}"
            path.write_bytes(mutated(data, rng, pieces))
            found["inputs"] += 1
            try:
                read = load_data(path, Ts=1.0)
            except FileError as err:
                _short(err, path)
                found["refused"] += 1
                continue
            assert np.isfinite(read.u).all()
            found["read"] += 1
    return found
