"""Every import contract of pyproject.toml holds, and breaks when one line is added that it forbids."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
    "contracts"
]

# contract id, file in the installed package, line that breaks the contract
OFFENCES = [
    ("floors", "signal/welch.py", "from cyclofeat.recordings import Recording\nimport cyclofeat.features"),
    ("floors", "recordings/_windower.py", "from cyclofeat.gap import locate"),
    ("floors", "counting/__init__.py", "def later():\n    from cyclofeat.plotting import LobeMapDisplay"),
    ("floors", "_base/files.py", "import cyclofeat.signal"),
    ("floors", "gap/__init__.py", "from cyclofeat.report import write_gap_report"),
    ("floors", "report/__init__.py", "def later():\n    import cyclofeat.serve"),
    ("floors", "serve/__init__.py", "from cyclofeat.cli import main"),
    ("simulators", "simulators/gearbox.py", "from cyclofeat.recordings import Recording"),
    ("simulators", "simulators/gearbox.py", "from ..datasets import load_published_tables"),
    ("simulators", "simulators/gearbox.py", "def later():\n    import cyclofeat.features"),
    ("simulators-root", "simulators/gearbox.py", "from cyclofeat import Recording"),
    ("simulators-root", "simulators/__init__.py", "import cyclofeat"),
    ("kernels", "simulators/_kernels.py", "from .geometry import CycloidalGeometry"),
    ("kernels", "simulators/_jit.py", "import cyclofeat"),
    ("datasets", "datasets/__init__.py", "from cyclofeat.features import TorqueStatistics"),
    ("datasets", "datasets/new.py", "import cyclofeat.counting"),
    ("features", "features/new.py", "from cyclofeat.simulators import simulate"),
    ("features", "features/__init__.py", "from cyclofeat.datasets import load_published_tables"),
]

ALLOWED = [
    ("datasets/new.py", "from cyclofeat.recordings import Recording"),
    ("datasets/__init__.py", "from cyclofeat.simulators.gearbox import CycloidalGearbox"),
    ("simulators/gearbox.py", "from cyclofeat._base.files import write_whole"),
    ("recordings/__init__.py", "import cyclofeat.signal.orders"),
    ("counting/__init__.py", "from cyclofeat.features import TorqueStatistics"),
]


@pytest.fixture
def tree(tmp_path):
    """The package as it lies once installed, without building a wheel."""
    package = tmp_path / "cyclofeat"
    no_caches = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "cyclofeat", package, ignore=no_caches)
    for room in ("simulators", "datasets"):
        shutil.copytree(ROOT / room, package / room, ignore=no_caches)
    return package


def add_line(path: Path, line: str) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write(f"\n{line}\n")


def broken_contracts(tree: Path) -> set[str]:
    """Names of the broken contracts, by lint-imports itself."""
    lint = Path(sys.executable).with_name("lint-imports")
    run = subprocess.run(
        [lint, "--config", ROOT / "pyproject.toml", "--no-cache"],
        cwd=tree.parent,
        env=os.environ | {"COLUMNS": "200"},  # else a long name is broken over two lines
        capture_output=True,
        text=True,
    )
    verdicts = dict(re.findall(r"^(.+?) (KEPT|BROKEN)\b", run.stdout, flags=re.MULTILINE))
    assert verdicts.keys() == {contract["name"] for contract in CONTRACTS}, run.stdout + run.stderr
    broken = {name for name, verdict in verdicts.items() if verdict == "BROKEN"}
    assert (run.returncode != 0) == bool(broken)
    return broken


def test_the_house_keeps_its_contracts(tree):
    assert broken_contracts(tree) == set()


@pytest.mark.parametrize(("contract", "file", "line"), OFFENCES)
def test_contract_bites(tree, contract, file, line):
    names = {entry["id"]: entry["name"] for entry in CONTRACTS}
    add_line(tree / file, line)
    assert names[contract] in broken_contracts(tree)


def test_contracts_admit_what_is_allowed(tree):
    for file, line in ALLOWED:
        add_line(tree / file, line)
    assert broken_contracts(tree) == set()


def test_every_contract_is_broken_here_once():
    assert {contract for contract, _, _ in OFFENCES} == {contract["id"] for contract in CONTRACTS}
