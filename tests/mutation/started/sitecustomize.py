"""Plants the bug that MUTANT_OF_ARMRIG leads to in every interpreter that a test starts.

Python imports this module at its start where the folder is on PYTHONPATH; see `mutation.planting`.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

if _kept := os.environ.get("MUTANT_OF_ARMRIG"):
    _tests = str(Path(__file__).parents[2])
    sys.path.append(_tests)
    from mutation.planting import plant_kept

    sys.path.remove(_tests)
    plant_kept(_kept)
