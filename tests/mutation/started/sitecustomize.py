"""Plants the bug that MUTANT_OF_ARMRIG leads to in every interpreter that a test starts.

Python imports it at its start if its folder is on PYTHONPATH; see `tests.mutation.planting`.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

if _kept := os.environ.get("MUTANT_OF_ARMRIG"):
    _root = str(Path(__file__).parents[3])
    sys.path.append(_root)
    from tests.mutation.planting import plant_kept

    sys.path.remove(_root)
    plant_kept(_kept)
