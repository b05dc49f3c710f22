"""The pages of the reports' tests are looked at in a browser, too."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "report"))
