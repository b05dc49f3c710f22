"""The papers' results are measured as in the examples that show them."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "papers"))
