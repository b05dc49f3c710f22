"""Folder of stored simulations that take long."""

from pathlib import Path

DATA = Path(__file__).parent / "data"
