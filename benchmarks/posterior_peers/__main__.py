"""The joint posterior beside other methods on the same rigs: ``python -m benchmarks.posterior_peers``.

Simulates a bank of rigs into ``build/posterior_peers``, which an interrupted run continues, and writes
``benchmarks/posterior_peers.md``. sbi and BayesFlow run in ``build/posterior_peers/venv`` (``make
bench-posterior-peers`` makes it).
"""

from __future__ import annotations

import argparse
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import ExtraTreesClassifier, ExtraTreesRegressor

from benchmarks._markdown import table
from benchmarks.hidden_effects._table import calibration_error
from cyclofeat.gap import EffectPosterior, World, load_posterior, prepare_world
from cyclofeat.gap.posterior.calibration import gain_and_offset
from cyclofeat.gap.world.world import Rigs, Session

Float = NDArray[np.float64]

PAGE = Path(__file__).parents[1] / "posterior_peers.md"
FOLDER = Path("build/posterior_peers")
SEED, RIGS_PER_MACHINE = 20261125, 4
JUDGED = 1 / 4  # of the machines
N_TREES, LEAF = 200, 3
NOISE = 0.1  # spread that makes a presence of 0 or 1 continuous, for flows
LEAST = 1e-3  # probability: a method that is sure and wrong loses no more


@dataclass(frozen=True)
class Answers:
    """What a method says of the rigs judged.

    Attributes
    ----------
    presence : ndarray, shape (n_rigs, n_effects)
    low, middle, high : ndarray, shape (n_rigs, n_sizes)
        0.05, 0.5 and 0.95 quantile of standardised sizes; NaN where it states none.
    fit, answer : float
        Seconds for all rigs.
    """

    presence: Float
    low: Float
    middle: Float
    high: Float
    fit: float
    answer: float


def ours(
    posterior: EffectPosterior, train: Rigs | None, sessions: Sequence[Session], scale: Scale
) -> Answers:
    """The joint posterior; without rigs to learn from, as it is."""
    began = time.perf_counter()
    if train is not None:
        posterior.fit(train)
    fitted = time.perf_counter()
    presence = np.nan_to_num(posterior.predict_proba(sessions))
    quantiles = np.array([[*guess.sizes.values()] for guess in posterior.guess(sessions)])
    answered = time.perf_counter()
    logarithmic = np.array(posterior.logarithmic_)[:, None]
    on_scale = np.where(logarithmic, np.log(np.where(logarithmic, quantiles, 1.0)), quantiles)
    low, middle, high = (scale(on_scale[:, :, k]) for k in (0, 2, 4))
    return Answers(presence, low, middle, high, fitted - began, answered - fitted)


class Scale:
    """Standardises sizes by their mean and spread over the rigs that have them."""

    def __init__(self, sizes: Float) -> None:
        self.centre, self.spread = np.nanmean(sizes, axis=0), np.nanstd(sizes, axis=0)

    def __call__(self, sizes: Float) -> Float:
        """Return standardised sizes."""
        return np.asarray((sizes - self.centre) / self.spread)


def summaries(posterior: EffectPosterior, sessions: Sequence[Session]) -> Float:
    """Return one row of numbers for each session: means, spreads, gain and offset, conditions."""
    rows = []
    for session in sessions:
        deviations = posterior.reference_.deviations(session.values, session.conditions, session.counts)
        spread = np.log(deviations[:, : len(posterior.cells_)].std(axis=0) + 0.1)
        mean = session.values[:, posterior.cells_.index("amplitudes: mean")]
        shown = np.ones((1, len(mean)), dtype=bool)
        constant = gain_and_offset(mean[None], session.conditions[None], shown)[0]
        at = session.conditions
        facts = [*at.mean(axis=0), *at.std(axis=0), np.log(len(at))]
        rows.append(np.concatenate([deviations.mean(axis=0), spread, constant, facts]))
    return np.array(rows)


def forests(train_x: Float, train: Rigs, test_x: Float, scale: Scale) -> Answers:
    """A forest of trees for each effect, and one for each size."""
    seconds = np.zeros(2)  # of fits and answers

    def answers(kind: type, method: str, y: Float) -> Float:
        forest, known = kind(N_TREES, min_samples_leaf=LEAF, random_state=0, max_features=0.1), np.isfinite(y)
        began = time.perf_counter()
        forest.fit(train_x[known], y[known])
        fitted = time.perf_counter()
        said: Float = getattr(forest, method)(test_x)
        seconds[:] += fitted - began, time.perf_counter() - fitted
        return said

    presence = [answers(ExtraTreesClassifier, "predict_proba", y)[:, 1] for y in train.present.T]
    middle = np.transpose([answers(ExtraTreesRegressor, "predict", y) for y in scale(train.sizes).T])
    none = np.full(middle.shape, np.nan)
    return Answers(np.transpose(presence), none, middle, none, *seconds)


def flow(name: str, train_x: Float, train: Rigs, test_x: Float, scale: Scale, folder: Path) -> Answers:
    """sbi or BayesFlow: a flow over presence, made continuous, and sizes, drawn anew where absent."""
    random = np.random.default_rng(0)
    sizes = scale(train.sizes)
    for column in sizes.T:
        absent = ~np.isfinite(column)
        column[absent] = random.choice(column[~absent], absent.sum())
    presence = train.present + random.normal(0, NOISE, train.present.shape)
    folder = folder.resolve()
    source, target = folder / "flow_in.npz", folder / f"{name}.npz"
    np.savez(source, train_x=train_x, train_theta=np.hstack([presence, sizes]), test_x=test_x)
    python, script = folder / "venv/bin/python", Path(__file__).resolve().with_name("_flows.py")
    subprocess.run([python, script, name, source, target], check=True, cwd=folder)  # sbi writes logs there
    with np.load(target) as file:
        samples, fit, answer = file["samples"], float(file["fit"]), float(file["answer"])
    n = len(train.names)
    low, middle, high = np.quantile(samples[:, :, n:], (0.05, 0.5, 0.95), axis=1)
    return Answers((samples[:, :, :n] > 0.5).mean(axis=1), low, middle, high, fit, answer)


def row(name: str, said: Answers, judged: Rigs, scale: Scale) -> list[str]:
    """Return a row of the table."""
    present, sizes = judged.present, scale(judged.sizes)
    p = np.clip(said.presence, LEAST, 1 - LEAST)
    loss = -np.where(present, np.log(p), np.log(1 - p)).sum(axis=1).mean()
    named = said.presence > 0.5
    none = ~present.any(axis=1)
    error_of_calibration = calibration_error(said.presence.ravel(), present.ravel())
    there = np.isfinite(sizes)
    error = np.abs(said.middle - sizes)[there]
    covered = ((said.low <= sizes) & (sizes <= said.high))[there]
    stated = np.isfinite(said.low).all()
    right = f"{present[named].mean():.3f}" if named.any() else "-"
    return [
        name, f"{loss:.2f}", right, f"{named[present].mean():.3f}",
        f"{named[none].any(axis=1).mean():.3f}", f"{error_of_calibration:.3f}",
        f"{np.nanmedian(error):.2f}", f"{covered.mean():.2f}" if stated else "-",
        f"{said.fit:.0f}" if said.fit > 0.5 else "-", f"{1e3 * said.answer / len(judged):.1f}",
    ]  # fmt: skip


HEAD = (
    "method", "loss, nats", "names right", "recall, all hidden", "a wrong name without effects",
    "calibration error", "median error of sizes", "90 % intervals that cover", "fit, s", "answer, ms",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--machines", type=int, default=1000, help="simulated (default 1000, a quarter judged)"
    )
    parser.add_argument("--folder", type=Path, default=FOLDER, help="of the bank and of venv")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--page", type=Path, default=PAGE)
    given = parser.parse_args()
    if not (given.folder / "venv/bin/python").exists():
        parser.error(f"{given.folder}/venv is missing: make bench-posterior-peers makes it")
    world = World(n_rigs_per_machine=RIGS_PER_MACHINE, random_state=SEED)
    rigs = prepare_world(
        world, given.folder / "bank", given.machines, n_jobs=given.jobs,
        progress=lambda done, n: print(f"{done} of {n} shards", flush=True),
    )  # fmt: skip
    held = rigs.machines >= given.machines * (1 - JUDGED)
    train, judged = rigs.of(~held), rigs.of(held)
    scale = Scale(train.sizes)
    tests, trains = ([some.session(k) for k in range(len(some))] for some in (judged, train))
    anew = EffectPosterior()
    said = {"joint posterior (ours)": ours(anew, train, tests, scale)}
    train_x, test_x = summaries(anew, trains), summaries(anew, tests)
    methods: dict[str, Callable[[], Answers]] = {
        "a forest per effect": lambda: forests(train_x, train, test_x, scale),
        "sbi, neural posterior estimation": lambda: flow("sbi", train_x, train, test_x, scale, given.folder),
        "BayesFlow, coupling flow": lambda: flow("bayesflow", train_x, train, test_x, scale, given.folder),
    }
    for name, method in methods.items():
        said[name] = method()
        print(row(name, said[name], judged, scale), flush=True)
    share = train.present.mean(axis=0)
    flat = np.zeros((len(judged), len(train.size_names)))
    said["prior alone"] = Answers(
        np.broadcast_to(share, judged.present.shape), flat - 1.645, flat, flat + 1.645, 0.0, 0.0
    )
    packaged = load_posterior()
    said[f"packaged posterior, of {packaged.n_rigs_:,} rigs"] = ours(packaged, None, tests, scale)
    text = PAGE_TEXT.format(
        machines=given.machines, train=len(train), judged=len(judged),
        rows=table(HEAD, [row(name, one, judged, scale) for name, one in said.items()]),
    )  # fmt: skip
    given.page.write_text(text, encoding="utf-8")
    print(text)


PAGE_TEXT = """# The joint posterior beside other methods

Made by `python -m benchmarks.posterior_peers --machines {machines}`. All recordings are **simulated**. Every
method but the last learns from the same {train:,} rigs with none to six of 32 effects, and is judged on
{judged:,} rigs of other machines, with all recordings and known counts. "Loss" is the mean of minus the
logarithm of the probability given to what each rig has and lacks (of at least 0.001), summed over effects.
Errors of sizes are in standard deviations of the prior, of all effects that a rig has. Times are those of one
thread, for all rigs and for one.

Ours takes the summaries of each recording; the others take means and spreads over recordings, the fit of gain
and offset, and the conditions: the flows as 100 principal components. Flows learn presence as a number around
0 or 1. Both are the default flow of their package.

{rows}"""


if __name__ == "__main__":
    main()
