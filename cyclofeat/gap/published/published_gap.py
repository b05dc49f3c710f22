"""The gap in published statistics: one row of numbers per disc, without recordings."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from cyclofeat._base.checks import different_names, one_of
from cyclofeat._base.displays import data_frame
from cyclofeat.gap.comparison import Comparison
from cyclofeat.gap.published.rigs import SET_POINT, PublishedSettings, Set, SimulatedRigs, kind_of
from cyclofeat.gap.published.scores import STATISTICS, fewest_units, sign_flip_p, to_statistics
from cyclofeat.gap.published.search import Search, Step, Tried
from cyclofeat.gap.result import Size
from cyclofeat.gap.where.permutation import holm
from cyclofeat.simulators import Effect, Rig, known_effects

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]
Table = Literal["discrepancies", "ranking", "steps", "rejected", "parameters", "held_out"]

# Effects that show as an error of the time axis do not change minimum, maximum, mean or deviation.
_UNSEEN = "time axis"


@dataclass(frozen=True)
class Discrepancy:
    """Difference between a measured statistic and that of the simulator alone.

    Attributes
    ----------
    statistic : str
    unit : str
    difference : float
        Mean over the discs of measured minus simulated; for sizes of the natural logarithm of their ratio.
    low, high : float
        95 % interval of that mean by Student's t over the discs.
    same_sign : int
        Discs whose difference has the sign of the mean.
    p : float
        Exact two-sided sign-flip p over the discs, never below 2 / 2^n.
    p_adjusted : float
        The same after Holm over the statistics.
    """

    statistic: str
    unit: str
    difference: float
    low: float
    high: float
    same_sign: int
    p: float
    p_adjusted: float


@dataclass(frozen=True)
class HeldOut:
    """Prediction of one statistic of a disc that neither naming nor fitting has seen.

    Attributes
    ----------
    disc : int
        Count of worn lobes.
    effects : tuple of str
        Named without this disc.
    statistic : str
        One of ``STATISTICS``, ``"range"`` or ``"entropy"``.
    measured, predicted, low, high : float
        In Nm or bits; median and 80 % interval of the prediction.
    nothing : float
        The simulator alone.
    constant : float
        Mean of the other discs.
    """

    disc: int
    effects: Set
    statistic: str
    measured: float
    predicted: float
    low: float
    high: float
    nothing: float
    constant: float


@dataclass(frozen=True)
class PublishedGap:
    """Result of :func:`find_published_gap`.

    Attributes
    ----------
    discrepancies : tuple of Discrepancy
    ranking : tuple of Tried
        Single effects by the score of discs left out, best first; ``"nothing"`` and ``"constant"`` (mean of
        the other discs) among them.
    steps : tuple of Step
        The effects named, in the order in which they were added, with their look-alikes.
    rejected : tuple of Tried
        Effects that the search would try next.
    dropped : tuple of str
        Effects that were added and taken out again.
    effects : tuple of Effect
        With the parameters of the rig of the largest weight.
    parameters : tuple of Size
        The same, named as ``"noise.rms_nm"``, with the weighted 5 % and 95 % quantiles over all rigs.
    rig : Rig
        The model with the effects.
    held_out : tuple of HeldOut
        Each disc predicted without it; the naming is repeated without it.
    measured, fitted : ndarray, shape (n_discs, 4)
        Mean minus set-point in Nm and natural logarithms of standard deviation, upward and downward
        excursion: measured, and medians of the corrected model.
    warnings : tuple of str
        Warnings of too few discs.
    n_simulated, n_failed : int
        Records simulated for this result, and those that could not be.
    """

    discrepancies: tuple[Discrepancy, ...]
    ranking: tuple[Tried, ...]
    steps: tuple[Step, ...]
    rejected: tuple[Tried, ...]
    dropped: tuple[str, ...]
    effects: tuple[Effect, ...]
    parameters: tuple[Size, ...]
    rig: Rig
    held_out: tuple[HeldOut, ...] = field(repr=False)
    measured: Float = field(repr=False)
    fitted: Float = field(repr=False)
    warnings: tuple[str, ...]
    n_simulated: int
    n_failed: int
    _rigs: SimulatedRigs = field(repr=False, compare=False)

    def to_frame(self, table: Table = "ranking") -> pd.DataFrame:
        """Return one table of the result as a data frame; needs pandas.

        Parameters
        ----------
        table : {"discrepancies", "ranking", "steps", "rejected", "parameters", "held_out"}, default="ranking"

        Returns
        -------
        pandas.DataFrame
            One row per statistic, effect, effect named, effect that is next, parameter, or prediction.
        """
        return data_frame([asdict(row) for row in getattr(self, one_of("table", table, get_args(Table)))])

    def save_table(self, path: str | os.PathLike[str]) -> None:
        """Write the statistics of all simulated rigs, for :attr:`PublishedSettings.table`.

        The file is compressed and of half precision: 0.1 % of a size.
        """
        self._rigs.save(Path(path))


def find_published_gap(
    comparison: Comparison,
    statistics: Any,
    entropy: ArrayLike | None = None,
    *,
    settings: PublishedSettings | None = None,
) -> PublishedGap:
    """Find where and why published statistics of torque differ from the simulator's, without recordings.

    Up to ``settings.max_effects`` effects of the library are named and added to the simulator, and discs are
    predicted that had no part in naming and fitting.

    Parameters
    ----------
    comparison : Comparison
        Model, what may differ between discs, and sampling rate of the records.
    statistics : structured array, mapping or data frame
        Columns ``defect_count``, ``min_nm``, ``max_nm``, ``mean_nm`` and ``std_nm``, one row per disc, 3 to
        20 of them; a ``range_nm`` is checked against ``max_nm`` minus ``min_nm``.
    entropy : array-like, shape (n_discs,), optional
        Published Shannon entropies in bits (MATLAB's ``pwelch`` defaults). They are predicted and compared,
        never used in naming or fitting.
    settings : PublishedSettings, optional

    Returns
    -------
    PublishedGap

    Raises
    ------
    ValueError
        If columns are missing or contradict each other, there are too few discs, the library names an
        unknown effect, or the table was made with other settings.

    Notes
    -----
    *Simulations.* A simulated rig has one set of parameters for all its discs. Assemblies, first worn lobe,
    wheel, start and noise differ between discs, with the same random numbers for all effects. The rigs of a
    set of effects are a Latin hypercube over the priors. A Gaussian process interpolates the expected
    statistics of 512 more rigs; their noise is that of the nearest simulated rigs.

    *Weights.* The weight of a rig is exp(-sum over the fitted discs of the mean CRPS of the four statistics /
    half the measured spread over the discs). This is a generalised posterior (Bissiri et al. 2016): unlike a
    likelihood, it is not dominated by a statistic that no effect reaches. A held-out disc is scored by the
    CRPS of the weighted prediction, each statistic divided by its measured spread over the discs.

    *p-values.* The p over n discs is never below 2^-n. So at the default ``alpha`` at least 5 discs are
    needed to name an effect, and at least 6 for ``held_out`` (``warnings``). The p of a step is optimistic,
    because it is that of the best of all candidates. ``held_out`` is not: it repeats the whole search without
    each disc.

    Examples
    --------
    >>> from cyclofeat.datasets import load_published_tables
    >>> published = load_published_tables().signal_statistics
    >>> settings = PublishedSettings(library=["offset"], n_draws=1, duration=0.1, max_effects=1)
    >>> gap = find_published_gap(Comparison(sampling_rate=25_600), published, settings=settings)
    >>> [row.statistic for row in gap.discrepancies if row.same_sign == 8]
    ['mean', 'std', 'up', 'down', 'range']
    """
    settings = PublishedSettings() if settings is None else settings
    counts, columns = _table_columns(statistics)
    n = len(counts)
    entropies = None if entropy is None else np.asarray(entropy, dtype=np.float64)
    if entropies is not None and (entropies.shape != (n,) or not np.isfinite(entropies).all()):
        raise ValueError(f"entropy must hold {n} finite numbers, one per disc, got {entropy!r}")
    known = (*known_effects(proposed=True), SET_POINT)
    if settings.library is None:
        library = tuple(name for name in known if kind_of(name).shows_as != _UNSEEN)
    else:
        chosen = different_names(settings.library, known, "library")
        library = tuple(name for name in known if name in chosen)
    rigs = SimulatedRigs(comparison, counts, settings)
    measured = to_statistics(columns, rigs.set_point)
    search = Search(rigs, measured, library, settings)
    discs = tuple(range(n))
    named, steps, dropped = search.name(discs)
    dense, weights = search.weighted_rigs(named), search.weights(named, discs)
    best = dense.theta[int(np.argmax(weights))]
    effects = rigs.effects(named, best)
    parameters = []
    for k, (effect, name) in enumerate(rigs.parameter_names(named)):
        order = np.argsort(dense.theta[:, k])
        at = np.searchsorted(np.cumsum(weights[order]), (0.05, 0.95)).clip(max=len(order) - 1)
        unit = kind_of(effect).parameters[name].unit
        parameters.append(Size(f"{effect}.{name}", unit, float(best[k]), *dense.theta[order[at], k].tolist()))
    warnings, fewest = [], fewest_units(settings.alpha)
    if n < fewest:
        warnings.append(
            f"{n} discs: no effect can be named, as p over them is never below {2.0**-n:.2g} and alpha is "
            f"{settings.alpha:g}; it takes at least {fewest}, and {fewest + 1} to predict one by the others"
        )
    elif n == fewest:
        warnings.append(
            f"{n} discs: no effect can be named without one of them, so held_out is the simulator alone; it "
            f"takes at least {fewest + 1} at alpha={settings.alpha:g}"
        )
    return PublishedGap(
        discrepancies=_locate_statistics(measured, rigs.table(()).values.mean(axis=(0, 1))),
        ranking=search.ranking(discs),
        steps=steps,
        rejected=search.rejected_effects(named, discs),
        dropped=dropped,
        effects=effects,
        parameters=tuple(parameters),
        rig=rigs.rig(effects),
        held_out=tuple(row for disc in discs for row in predict_statistics(search, disc, entropies)),
        measured=measured,
        fitted=np.array([np.median(search.sample(named, discs, disc)[0], axis=0) for disc in discs]),
        warnings=tuple(warnings),
        n_simulated=rigs.n_simulated,
        n_failed=rigs.n_failed,
        _rigs=rigs,
    )


def predict_statistics(search: Search, disc: int, entropies: Float | None = None) -> list[HeldOut]:
    """Predict a disc from the others, with effects named without it."""
    measured, rigs = search.measured, search.rigs
    others = tuple(other for other in range(len(measured)) if other != disc)
    named, _, _ = search.name(others)
    sample, of_rig = search.sample(named, others, disc)
    nothing, _ = search.sample((), others, disc)
    # Measured value, prediction, prediction by the simulator alone, and values of the other discs.
    parts = (measured[[disc]], sample, nothing, measured[list(others)])
    columns = {"mean": tuple(part[:, 0] + rigs.set_point for part in parts)}
    for k, name in enumerate(STATISTICS[1:], start=1):
        columns[name] = tuple(np.exp(part[:, k]) for part in parts)
    columns["range"] = tuple(np.exp(part[:, 2:]).sum(axis=1) for part in parts)
    if entropies is not None:
        near = search.weighted_rigs(named).nearest[of_rig]
        simulated, alone = rigs.entropies(named)[near, :, disc], rigs.entropies(())[:, :, disc]
        columns["entropy"] = (entropies[[disc]], simulated.ravel(), alone.ravel(), entropies[list(others)])
    rows = []
    for name, (value, predictions, without, rest) in columns.items():
        low, middle, high = (float(q) for q in np.quantile(predictions, (0.1, 0.5, 0.9)))
        rows.append(
            HeldOut(
                disc=int(rigs.counts[disc]), effects=named, statistic=name, measured=float(value[0]),
                predicted=middle, low=low, high=high, nothing=float(np.median(without)),
                constant=float(np.mean(rest)),
            )
        )  # fmt: skip
    return rows


def _locate_statistics(measured: Float, expected: Float) -> tuple[Discrepancy, ...]:
    """Return the differences of the statistics from those expected for the count of each disc."""
    differences = {name: measured[:, k] - expected[:, k] for k, name in enumerate(STATISTICS)}
    ranges = (np.log(np.exp(values[:, 2:]).sum(axis=1)) for values in (measured, expected))
    differences["range"] = np.subtract(*ranges)
    differences["up over down"] = (measured[:, 2] - measured[:, 3]) - (expected[:, 2] - expected[:, 3])
    p = {name: sign_flip_p(d) for name, d in differences.items()}
    adjusted = holm(p)
    rows = []
    for name, d in differences.items():
        half = stats.t.ppf(0.975, d.size - 1) * d.std(ddof=1) / np.sqrt(d.size)
        rows.append(
            Discrepancy(
                statistic=name,
                unit="Nm" if name == "mean" else "ln ratio",
                difference=float(d.mean()),
                low=float(d.mean() - half),
                high=float(d.mean() + half),
                same_sign=int(np.sum(np.sign(d) == np.sign(d.mean()))),
                p=p[name],
                p_adjusted=adjusted[name],
            )
        )
    return tuple(rows)


def _table_columns(table: Any) -> tuple[NDArray[np.int64], Float]:
    """Return counts, and minimum, maximum, mean and standard deviation (n_discs, 4), of a checked table."""
    wanted = ("defect_count", "min_nm", "max_nm", "mean_nm", "std_nm")
    try:
        values = np.array([np.asarray(table[name], dtype=np.float64) for name in wanted])
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ValueError(
            f"statistics must be a table with the columns {', '.join(wanted)}: {error}"
        ) from None
    if values.ndim != 2 or not 3 <= values.shape[1] <= 20:
        raise ValueError(f"statistics must have 3 to 20 rows, one per disc, got {values.shape[1:]}")
    counts, minimum, maximum, mean, std = values
    if not np.isfinite(values).all():
        raise ValueError("statistics must hold finite numbers, got NaN or infinity")
    if (counts != counts.round()).any() or counts.min() < 0:
        raise ValueError(f"defect_count must hold whole numbers from 0, got {counts.tolist()}")
    if not ((minimum < mean) & (mean < maximum) & (std > 0)).all():
        raise ValueError("statistics must have min_nm < mean_nm < max_nm and std_nm above 0 in every row")
    try:
        stated = np.asarray(table["range_nm"], dtype=np.float64)
    except (KeyError, IndexError, ValueError):
        stated = maximum - minimum
    # Printed numbers are rounded to four digits each.
    if (np.abs(stated - (maximum - minimum)) > 0.02).any():
        raise ValueError("range_nm must be max_nm minus min_nm")
    return counts.astype(np.int64), values[1:].T
