"""Find the rig whose surrogate torque has the statistics of paper A's table 4.

Writes the rig to ``datasets/tables/published_rig.json`` and the agreement of its statistics with table 4 to
``benchmarks/published_rig.md`` (a quarter of an hour on one core)::

    python -m benchmarks.published_rig --fit       # search anew, then score
    python -m benchmarks.published_rig             # score the committed numbers on unused assemblies

The search uses only the 32 numbers of table 4: eight discs with one record each. It tries a free output and
brake rotors behind a torque meter, each with the best-fitting fluctuation in proportion to the brake's torque
(:class:`cyclofeat.simulators.ProportionalDrift`). Eight discs cannot prove the result: this rig gives such
numbers, but it need not be the rig that was measured.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import qmc, spearmanr

from benchmarks._markdown import table
from cyclofeat import Recording
from cyclofeat.datasets import load_published_tables, make_rig_recordings, rig_preset
from cyclofeat.signal import shannon_entropy, spectral_centroid, welch_psd
from cyclofeat.simulators import (
    BrakeRotor,
    CycloidalGearbox,
    Noise,
    Offset,
    ProportionalDrift,
    Rig,
    SimulationFailed,
)

ROOT = Path(__file__).parents[1]
# Brakes tried, evenly in the logarithm: rotor and meter as those of rig R2, widened.
BRAKES = {
    "brake_inertia_kg_m2": (0.002, 0.1),
    "meter_stiffness_nm_per_rad": (1e3, 3e4),
    "meter_damping_ratio": (0.02, 0.15),
}
N_BRAKES = 16
# Drift: its standard deviation (of the logarithm), its cutoff in Hz, the factor by which recordings differ.
DRIFT = ((0.03, 0.25), (4.0, 400.0), (1.0, 2.0))
DURATION_S, SAMPLING_RATE, WARM_UP_S = 1.8, 25_600.0, 0.7
NOISE_NM = 0.2  # as rigs R0 to R2; eight discs do not determine it
QUIET = {
    "relative_drift_low": 0.0, "relative_drift_high": 0.0, "drift_cutoff_hz": 1.0, "offset_nm": 0.0,
    "noise_nm": 0.0,
}  # fmt: skip
# Seeds. 100 to 107 scored an earlier preset from superposition alone, whose swings were too large; therefore
# whole simulations now decide among the best few. These seeds are no longer used for scores.
SEARCHED, CHECKED, SCORED = 0, range(1, 3), range(300, 308)
N_DRAWS, N_BEST = 4, 4
FREE_CUTOFFS = (40.0, 60.0, 90.0, 130.0)  # Hz; a free output rings on its contacts: not superposed
HEAD = (
    "statistic", "published, mean over discs", "preset", "difference, in scatters",
    "scatter: published, preset", "discs in the preset's 80 %", "matched",
)  # fmt: skip
STATISTICS = ("ln std", "ln (max - mean)", "ln (mean - min)", "ln range")
Array = NDArray[np.float64]


def statistics(low: Array, high: Array, mean: Array, std: Array) -> Array:
    """The four shapes of table 4, shape (n, 4)."""
    return np.log(np.column_stack([std, high - mean, mean - low, high - low]))


def published() -> tuple[Array, Array]:
    """Statistics of the eight discs, shape (8, 4), and their means in Nm."""
    table = load_published_tables().signal_statistics
    low, high, mean, std = (np.asarray(table[f"{name}_nm"]) for name in ("min", "max", "mean", "std"))
    return statistics(low, high, mean, std), mean


def rig_of_values(values: dict[str, float]) -> Rig:
    """The rig with the numbers of the fit; a free output where they hold no brake."""
    brake = [values[name] for name in BRAKES if name in values]
    rig = Rig.r0().without("load_drift").replace(name="published")
    return rig.with_effects(
        ProportionalDrift(
            (values["relative_drift_low"], values["relative_drift_high"]), values["drift_cutoff_hz"]
        ),
        Offset(values["offset_nm"]),
        Noise(values["noise_nm"]),
        *([BrakeRotor(*brake)] if brake else []),
    )


def simulated(rig: Rig, seeds: Iterable[int]) -> list[list[Recording]]:
    """Surrogate records of 1.8 s of eight discs for each seed, all of assemblies of their own."""
    return [make_rig_recordings(1, range(8), rig=rig, duration=DURATION_S, random_state=s) for s in seeds]


def torque_of(made: list[list[Recording]]) -> Array:
    """Torque in Nm, shape (n_sets, 8, n_samples)."""
    return np.array([[r.torque for r in discs] for discs in made])


def shapes_of(X: Array) -> Array:
    """The four shapes of each record, shape (n_sets, 8, 4)."""
    return np.array([statistics(x.min(axis=1), x.max(axis=1), x.mean(axis=1), x.std(axis=1)) for x in X])


def misfit(shapes: Array, target: Array) -> tuple[float, float, float]:
    """Squared distances in scatters of the discs: of level, of scatter, and of the deviation's course.

    Level: means over the discs. Scatter: logarithm of the standard deviation over the discs, half weight.
    Course: how the deviation of the eight discs lies about its mean, averaged over the sets.
    """
    spread = target.std(axis=0, ddof=1)
    level = (shapes.mean(axis=(0, 1)) - target.mean(axis=0)) / spread
    scatter = np.log(shapes.std(axis=1, ddof=1).mean(axis=0) / spread)
    course = shapes[:, :, 0].mean(axis=0) - target[:, 0]
    course = (course - course.mean()) / spread[0]
    return float(level @ level), float(0.5 * scatter @ scatter), float(np.mean(course**2))


def brakes() -> list[dict[str, float]]:
    """Brakes that are tried; the first is none: the papers' free output."""
    low, high = np.log(list(BRAKES.values())).T
    unit = qmc.Sobol(len(BRAKES), scramble=True, rng=0).random(N_BRAKES)
    places = np.exp(low + unit * (high - low))
    return [{}, *(dict(zip(BRAKES, place.tolist(), strict=True)) for place in places)]


def ripples(brake: dict[str, float]) -> Array | None:
    """Torque of eight discs without drift and noise, less its mean; None for a rig that wedges."""
    try:
        (made,) = simulated(rig_of_values(brake | QUIET), [SEARCHED])
    except (SimulationFailed, ValueError):
        return None
    torque = np.array([r.torque for r in made])
    return torque - torque.mean(axis=1, keepdims=True)


def through_brake(load: Array, brake: dict[str, float]) -> Array:
    """What a meter reads of a fluctuating load, the gearbox held: H(s) = (c s + k) / (J s^2 + c s + k)."""
    if not brake:
        return load
    inertia, stiffness, ratio = (brake[name] for name in BRAKES)
    s = 2j * np.pi * np.fft.rfftfreq(load.shape[-1], 1 / SAMPLING_RATE)
    damper = 2 * ratio * math.sqrt(stiffness * inertia)
    response = (damper * s + stiffness) / (inertia * s**2 + damper * s + stiffness)
    return np.fft.irfft(np.fft.rfft(load) * response, load.shape[-1])


def superposed(ripple: Array, brake: dict[str, float], drift: Array, draw: int) -> Array:
    """Statistics of the discs' ripple with a drift on top, shape (8, 4): the search's stand-in for a run.

    ``drift``: logarithms of its standard deviation, its cutoff, and the factor by which recordings differ.
    """
    middle, cutoff, factor = np.exp(drift)
    random = np.random.default_rng([SEARCHED, draw])
    shapes = []
    time = np.arange(round((DURATION_S + WARM_UP_S) * SAMPLING_RATE)) / SAMPLING_RATE
    gearbox = CycloidalGearbox.steel()
    for own in ripple:
        relative = middle * factor ** random.uniform(-1, 1)
        load = ProportionalDrift(relative, cutoff).load_fluctuation(gearbox, time[-1], random)
        assert load is not None
        read = through_brake(load(time), brake)[-own.size :]
        torque = gearbox.load_torque + own + read + NOISE_NM * random.normal(size=own.size)
        shapes.append([torque.min(), torque.max(), torque.mean(), torque.std()])
    return statistics(*np.array(shapes).T)


@dataclass(frozen=True)
class Candidate:
    """A brake with the drift that suits it best."""

    brake: dict[str, float]
    drift: Array
    parts: tuple[float, float, float]

    @property
    def misfit(self) -> float:
        return sum(self.parts)


def best_drift(ripple: Array, brake: dict[str, float], target: Array) -> Candidate:
    """The drift that brings a brake's ripple nearest to table 4: from several starts, downhill."""

    def parts(drift: Array, n_draws: int) -> tuple[float, float, float]:
        inside = np.clip(drift, *np.log(DRIFT).T)
        return misfit(np.array([superposed(ripple, brake, inside, d) for d in range(n_draws)]), target)

    starts = [np.log([s, f, 1.3]) for s in (0.08, 0.16) for f in (10.0, 40.0, 160.0)]
    start = min(starts, key=lambda drift: sum(parts(drift, 2)))
    found = minimize(
        lambda drift: sum(parts(drift, N_DRAWS)), start, method="Nelder-Mead",
        options={"maxfev": 40, "initial_simplex": start + 0.3 * np.vstack([np.zeros(3), np.eye(3)])},
    )  # fmt: skip
    drift = np.clip(found.x, *np.log(DRIFT).T)
    return Candidate(brake, drift, parts(drift, N_DRAWS))


def search() -> list[Candidate]:
    """Every brake with its best drift, the best first; the free output is among them.

    Each brake's ripple is simulated once per disc, and drifts are laid over it.
    """
    target, _ = published()
    found = []
    for brake in brakes():
        ripple = ripples(brake)
        if ripple is None:
            continue
        found.append(best_drift(ripple, brake, target))
        last = found[-1]
        print(f"{last.misfit:6.2f} = {last.parts}  {np.exp(last.drift)}  {brake}", flush=True)
    return sorted(found, key=lambda candidate: candidate.misfit)


def simulated_whole(candidate: Candidate) -> Candidate:
    """The same with the misfit of whole simulations, the drift's size corrected once for their level."""
    target, _ = published()
    tried = []
    for _ in range(2):
        shapes = shapes_of(torque_of(simulated(rig_of_values(values_of(candidate)), CHECKED)))
        tried.append(replace(candidate, parts=misfit(shapes, target)))
        # All four statistics are logarithms, and grow with the drift nearly one to one.
        apart = float(np.mean(shapes.mean(axis=(0, 1)) - target.mean(axis=0)))
        candidate = replace(candidate, drift=candidate.drift - [apart, 0.0, 0.0])
    return min(tried, key=lambda one: one.misfit)


def check(found: list[Candidate]) -> list[Candidate]:
    """The best brakes of the search, and free outputs with slower drifts, simulated whole; best first."""
    free = next(one for one in found if not one.brake)
    slower = [replace(free, drift=np.array([free.drift[0], np.log(f), free.drift[2]])) for f in FREE_CUTOFFS]
    tried = [*[one for one in found if one.brake][:N_BEST], free, *slower]
    checked = []
    for one in tried:
        checked.append(simulated_whole(one))
        print(f"whole: {checked[-1].misfit:6.2f} = {checked[-1].parts}  {np.exp(one.drift)}  {one.brake}")
    return sorted(checked, key=lambda candidate: candidate.misfit)


def values_of(candidate: Candidate) -> dict[str, float]:
    """The rig's numbers, to three digits."""
    middle, cutoff, factor = np.exp(candidate.drift).tolist()
    found = {
        "relative_drift_low": middle / factor,
        "relative_drift_high": middle * factor,
        "drift_cutoff_hz": cutoff,
        # The drift leaves the mean load as it is, so that a constant makes up for the rest.
        "offset_nm": round(published()[1].mean() - CycloidalGearbox.steel().load_torque, 2),
        "noise_nm": NOISE_NM,
    }
    return {name: float(f"{value:.3g}") for name, value in (found | candidate.brake).items()}


def candidates(found: list[Candidate]) -> str:
    """Return a table of candidates in Markdown."""
    rows = []
    for one in found:
        rotor, meter, resonance = "none", "", ""
        if one.brake:
            inertia, stiffness, _ = (one.brake[name] for name in BRAKES)
            rotor, meter = f"{inertia:.2g}", f"{stiffness / 1e3:.2g}"
            resonance = f"{math.sqrt(stiffness / inertia) / (2 * math.pi):.0f}"
        middle, cutoff, _ = np.exp(one.drift)
        numbers = (f"{part:.2f}" for part in (*one.parts, one.misfit))
        rows.append([rotor, meter, resonance, f"{middle:.3f}", f"{cutoff:.0f}", *numbers])
    head = ("rotor, kg m2", "meter, kNm/rad", "resonance, Hz", "drift s", "cutoff, Hz")
    return table([*head, "level", "scatter", "course", "misfit"], rows)


def search_text(found: list[Candidate], checked: list[Candidate]) -> str:
    """Return the search's result, the misfit of each rig, as Markdown."""
    nearest = min(one.parts[2] for one in found)
    return f"""
## The search

A free output and {len(found) - 1} brakes (scrambled Sobol' sequence over rotors of 2e-3 to 0.1
kg m2, meters of 1 to 30 kNm/rad, 2 to 15 % damping), each with the best-fitting drift added to its
ripple. Misfit: squared distances of level, scatter and course from table 4, in scatters of the
discs; a constant course has 0.9. Whole simulations of the best few decided:

{candidates(checked)}
All candidates, superposed:

{candidates(found)}
This neither shows nor excludes that a brake's rotor makes the deviation fall with the count:
the best course is {nearest:.2f}, and {len(found) - 1} brakes are few, because the effect
depends on whether a lobe line meets the resonance.
"""


def score(rig: Rig) -> str:
    """Return the agreement of the rig, on assemblies not used in the search, as Markdown."""
    target, mean = published()
    tables = load_published_tables()
    made = simulated(rig, SCORED)
    X = torque_of(made)
    shapes = shapes_of(X)
    frequencies, psd = welch_psd(X, SAMPLING_RATE)
    centroid, entropy = spectral_centroid(psd, frequencies), shannon_entropy(psd)
    names = ["mean, Nm", *STATISTICS, "ln asymmetry", "centroid, Hz (table 5)", "entropy, bits (table 6)"]
    others = [tables.spectral_centroid["centroid"], tables.spectral_entropy["entropy_bits"]]
    measured = np.column_stack([mean, target, target[:, 1] - target[:, 2], *others])
    skew = (shapes[..., 1] - shapes[..., 2])[..., None]
    ours = np.concatenate(
        [X.mean(axis=2)[..., None], shapes, skew, centroid[..., None], entropy[..., None]], axis=2
    )
    compared = []
    for k, name in enumerate(names):
        level, ours_level = measured[:, k].mean(), ours[..., k].mean()
        spread, ours_spread = measured[:, k].std(ddof=1), ours[..., k].std(axis=1, ddof=1).mean()
        low, high = np.quantile(ours[..., k], [0.1, 0.9])
        inside = int(np.sum((measured[:, k] >= low) & (measured[:, k] <= high)))
        apart = (ours_level - level) / spread
        matched = "yes" if abs(apart) <= 1 else "**no**"
        numbers = f"{level:.2f}", f"{ours_level:.2f}", f"{apart:+.2f}", f"{spread:.2f}, {ours_spread:.2f}"
        compared.append([name, *numbers, f"{inside} of 8", matched])
    std = np.exp(np.median(shapes[..., 0], axis=0))
    ends = np.exp(np.quantile(shapes[..., 0], [0.1, 0.9], axis=0))
    course = [spearmanr(range(1, 8), s[1:, 0])[0] for s in shapes]
    said = spearmanr(range(1, 8), target[1:, 0])[0]
    least = sum(int(np.argmin(s[:, 0])) == 0 for s in shapes)
    asymmetry = np.exp(skew.mean(axis=(1, 2)))
    by_count = [
        ["std, published, Nm", *(f"{v:.2f}" for v in np.exp(target[:, 0]))],
        ["preset, median", *(f"{v:.2f}" for v in std)],
        ["preset, 10 to 90 %", *(f"{a:.2f} to {b:.2f}" for a, b in ends.T)],
    ]
    return f"""# The preset `published`

Made by `python -m benchmarks.published_rig`: {len(made)} sets of eight **surrogate** records of
{DURATION_S:g} s, none used in the search, which did not use centroid and entropy.
Matched: the mean over the discs lies within one scatter (standard deviation over the eight discs)
of the published one.

{table(HEAD, compared)}
Asymmetry, (max - mean) / (mean - min), geometric mean over the discs: \
{math.exp(measured[:, 5].mean()):.2f} published, {math.exp(skew.mean()):.2f} here
({asymmetry.min():.2f} to {asymmetry.max():.2f} from set to set).

{table(["worn lobes", *range(8)], by_count)}
The healthy disc has the least deviation in {least} of {len(made)} sets (published: yes). Rank
correlation of deviation and count, 1 to 7 worn lobes: {said:.2f} published, {np.mean(course):.2f}
here on average.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fit", action="store_true", help="search anew before scoring")
    page = ROOT / "benchmarks" / "published_rig.md"
    if parser.parse_args().fit:
        found = search()
        checked = check(found)
        rig_of_values(values_of(checked[0])).to_json(ROOT / "datasets" / "tables" / "published_rig.json")
        text = search_text(found, checked)
    else:
        text = "\n## The search\n" + page.read_text(encoding="utf-8").partition("\n## The search\n")[2]
    text = score(rig_preset("published")) + text
    print(text, end="")
    page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
