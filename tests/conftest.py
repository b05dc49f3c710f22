"""What the processes of one run of the tests share: the compiled simulator, simulated recordings."""

from __future__ import annotations

import gc
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:  # imported where needed: the process that hands out the tests runs none
    from cyclofeat.gap.where.locate import LocatedGap

os.environ["MPLBACKEND"] = "Agg"
sys.path.append(str(Path(__file__).parents[1]))  # the benchmarks are no part of the package


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the processor time of the run, that of all its processes together."""
    used = os.times()
    seconds = used.user + used.system + used.children_user + used.children_system
    terminalreporter.write_sep("=", f"{seconds:.0f} s of processor time")


def pytest_collection_finish() -> None:
    """Spare the garbage collector thousands of collected tests, which all live until the end."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def _close_figures() -> Iterator[None]:
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


class MadeOnce:
    """Results on disk: the first process that asks for one makes it, the others wait for it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(exist_ok=True)

    def __call__(self, name: str, make: Callable[[], Any]) -> Any:
        import joblib

        file, lock = self.folder / f"{name}.joblib", self.folder / name
        try:
            lock.mkdir()
        except FileExistsError:
            latest = time.monotonic() + 300
            while not file.exists() and lock.exists() and time.monotonic() < latest:
                time.sleep(0.1)
            return joblib.load(file)
        try:
            joblib.dump(make(), lock / file.name)
            os.replace(lock / file.name, file)
        except BaseException:
            lock.rmdir()
            raise
        return joblib.load(file)


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> MadeOnce:
    """Results of functions without arguments, by name."""
    base = tmp_path_factory.getbasetemp()
    folder: Path = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    return MadeOnce(folder / "made_once")


@pytest.fixture(autouse=True, scope="session")
def _compiled_once(made_once: MadeOnce, request: pytest.FixtureRequest) -> None:
    """Let one process of a parallel run compile each kernel, and the others load it."""
    worker = os.environ.get("PYTEST_XDIST_WORKER")
    if worker is None or os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        return
    from cyclofeat.simulators import CycloidalGearbox, simulate, simulate_many

    steel = CycloidalGearbox.steel(ramp_time=0.02)
    kernels: dict[str, Callable[[], Any]] = {
        "exact": lambda: simulate(steel, duration=0.005).torque_out.size,
        "batch": lambda: len(simulate_many([steel], duration=0.005, kernel="batch")),
    }
    if any(item.get_closest_marker("slow") for item in request.session.items):  # others have no friction
        rubbing = steel.replace(sleeve_friction=0.05)
        kernels["friction"] = lambda: simulate(rubbing, duration=0.005).torque_out.size
    for name in sorted(kernels, reverse=worker == "gw0"):
        made_once(name, kernels[name])


@pytest.fixture(scope="session")
def surrogates(made_once):
    """Eight surrogate assemblies of rig R1 for each of four defect counts."""
    from cyclofeat.datasets import make_rig_recordings
    from cyclofeat.simulators import Rig

    return made_once(
        "surrogates",
        lambda: make_rig_recordings(
            8, (0, 1, 3, 5), rig=Rig.r1(), random_state=11, with_angle=True, kernel="batch"
        ),
    )


@pytest.fixture(scope="session")
def shaft_options(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Options that name the small model that counts by the shaft's angle."""
    from small_model import shaft_model

    from cyclofeat.models import save_model

    file = save_model(tmp_path_factory.mktemp("model") / "m.joblib", shaft_model())
    return ["--model", str(file), "--trust"]


@pytest.fixture(scope="session")
def compared_hum(made_once: MadeOnce) -> dict[str, LocatedGap]:
    """Six recordings with strong hum, and six with nothing, compared with a small bank of a rig."""
    from cyclofeat.gap import Comparison
    from cyclofeat.gap.comparison import measured_turns
    from cyclofeat.gap.where.locate import locate
    from cyclofeat.simulators import BrakeRotor, CycloidalGearbox, Hum, Noise, Rig

    def make() -> dict[str, LocatedGap]:
        # Soon settled: short to simulate.
        gearbox = CycloidalGearbox.steel(ramp_time=0.05)
        rig = Rig(gearbox, [BrakeRotor(0.005, 1e4, 0.05), Noise(0.05)], name="R1")
        comparison = Comparison(sampling_rate=6400.0, rig=rig, n_bank=24)
        banks = {
            name: comparison.replace(rig=rig.with_added(*effects)).bank(6, [0, 3], random_state=seed)
            for name, effects, seed in (("hum", [Hum(2.0)], 102), ("nothing", [], 104))
        }
        return {
            name: locate(comparison, measured_turns(comparison, bank.X, y=bank.counts), n_permutations=499)
            for name, bank in banks.items()
        }

    return made_once("compared_hum", make)
