"""Where simulations that take long are kept."""

from pathlib import Path

DATA = Path(__file__).parent / "data"
