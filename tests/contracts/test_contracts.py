"""Every import contract of pyproject.toml holds, and breaks when lines are added that it forbids."""

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

# contract id, file in the installed package, line that breaks the contract, module that it imports
OFFENCES = [
    ("floors", "signal/welch.py", "from cyclofeat.recordings import Recording", "recordings"),
    ("floors", "signal/welch.py", "import cyclofeat.features", "features"),
    ("floors", "recordings/_windower.py", "from cyclofeat.gap import find_gap", "gap"),
    ("floors", "counting/__init__.py", "def later():\n    import cyclofeat.plotting", "plotting"),
    ("floors", "_base/files.py", "import cyclofeat.signal", "signal"),
    ("floors", "gap/__init__.py", "from cyclofeat.report import write_gap_report", "report"),
    ("floors", "report/__init__.py", "def later():\n    import cyclofeat.serve", "serve"),
    ("floors", "serve/__init__.py", "from cyclofeat.cli import main", "cli"),
    ("simulators", "simulators/gearbox.py", "from cyclofeat.recordings import Recording", "recordings"),
    ("simulators", "simulators/gearbox.py", "from ..datasets import load_published_tables", "datasets"),
    ("simulators", "simulators/gearbox.py", "def later():\n    import cyclofeat.features", "features"),
    ("simulators-root", "simulators/gearbox.py", "from cyclofeat import Recording", ""),
    ("simulators-root", "simulators/__init__.py", "import cyclofeat", ""),
    ("kernels", "simulators/_kernels.py", "from .gearbox import CycloidalGearbox", "simulators.gearbox"),
    ("kernels", "simulators/_jit.py", "import cyclofeat", ""),
    ("datasets", "datasets/__init__.py", "from cyclofeat.features import TorqueStatistics", "features"),
    ("datasets", "datasets/new.py", "import cyclofeat.counting", "counting"),
    ("features", "features/new.py", "from cyclofeat.simulators import simulate", "simulators"),
    ("features", "features/__init__.py", "from cyclofeat.datasets import load_published_tables", "datasets"),
]

ALLOWED = [
    ("datasets/new.py", "from cyclofeat.recordings import Recording"),
    ("datasets/__init__.py", "from cyclofeat.simulators.gearbox import CycloidalGearbox"),
    ("simulators/gearbox.py", "from cyclofeat._base.files import write_whole"),
    ("recordings/__init__.py", "import cyclofeat.signal.orders"),
    ("counting/__init__.py", "from cyclofeat.features import TorqueStatistics"),
]


def report(folder: Path, lines: list[tuple[str, str]]) -> tuple[bool, str]:
    """Verdict and text of lint-imports on the package with lines added to its files."""
    package = folder / "cyclofeat"  # as it lies once installed, without building a wheel
    no_caches = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "cyclofeat", package, ignore=no_caches)
    for room in ("simulators", "datasets"):
        shutil.copytree(ROOT / room, package / room, ignore=no_caches)
    for name, line in lines:
        with (package / name).open("a", encoding="utf-8") as file:
            file.write(f"\n{line}\n")
    lint = Path(sys.executable).with_name("lint-imports")
    run = subprocess.run(
        [lint, "--config", ROOT / "pyproject.toml", "--no-cache"],
        cwd=folder,
        env=os.environ | {"COLUMNS": "200"},  # else a long name is broken over two lines
        capture_output=True,
        text=True,
    )
    verdicts = dict(re.findall(r"^(.+?) (KEPT|BROKEN)\b", run.stdout, flags=re.MULTILINE))
    assert verdicts.keys() == {contract["name"] for contract in CONTRACTS}, run.stdout + run.stderr
    assert (run.returncode == 0) == (set(verdicts.values()) == {"KEPT"})
    return run.returncode == 0, run.stdout


@pytest.fixture(scope="module")
def broken(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What is printed of each contract, by its id, when all offences are committed at once."""
    kept, text = report(tmp_path_factory.mktemp("broken"), [(file, line) for _, file, line, _ in OFFENCES])
    assert not kept
    headings = {contract["id"]: rf"^{re.escape(contract['name'])}\n-+\n" for contract in CONTRACTS}
    return {
        one: re.split(heading, text, flags=re.MULTILINE)[1].split("\n-----", 1)[0]
        for one, heading in headings.items()
    }


def test_the_house_keeps_its_contracts_with_what_they_admit(tmp_path: Path) -> None:
    kept, text = report(tmp_path, ALLOWED)
    assert kept, text


@pytest.mark.parametrize(("contract", "file", "line", "imported"), OFFENCES)
def test_contract_bites(broken: dict[str, str], contract: str, file: str, line: str, imported: str) -> None:
    names = [".".join(["cyclofeat", *parts]) for parts in (_parts(file), filter(None, [imported]))]
    assert re.search(rf"^- +{re.escape(' -> '.join(names))} \(l\.", broken[contract], re.MULTILINE)


def _parts(file: str) -> list[str]:
    return file.removesuffix(".py").removesuffix("/__init__").split("/")


def test_every_contract_is_broken_here_once() -> None:
    assert {contract for contract, *_ in OFFENCES} == {contract["id"] for contract in CONTRACTS}
