"""Statistics that measure small changes of a simulated rig, and the responses of a rig to them.

A rig and changed rigs are simulated with the same random numbers, so that few pairs give each response almost
free of noise (Glasserman and Yao 1992, "Some guidelines and guarantees for common random numbers", Management
Science 38). Cells of recordings are whitened by the covariance of single recordings, and projected on the
responses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from sklearn.covariance import ledoit_wolf

Float = NDArray[np.float64]

_LINEAR = 3.0  # spreads up to which a deviation counts in full; larger ones count by their logarithm
_DIAGONAL = 0.2  # share of the diagonal in the covariance of the statistics
_NO_RESPONSE = 1e-9
_SMALLEST_SPREAD = 0.1


class Change(NamedTuple):
    """Change of a rig along a coordinate: cells of the changed rigs, and their places on the coordinate.

    ``cells`` has shape (n_places, n_pairs, n_recordings, n_cells), ``places`` one entry or two. With two,
    the response has a curvature.
    """

    cells: Float
    places: tuple[float, ...]


@dataclass(frozen=True)
class Projection:
    """Statistics of measured recordings, with their responses to changes of a rig and their covariance.

    ``measured`` (n_statistics,); ``responses`` (n_statistics, n_statistics) to the change and power of each
    entry of ``terms``; ``covariance`` of one session; ``weights`` (n_statistics, n_recordings, n_cells);
    ``slopes`` (n_changes, n_cells): mean deviation per unit of each change; ``spread_slopes``: the same of
    :func:`log_spreads`; ``centre``, ``spread`` and ``offset`` of the deviations; simulated ``sessions``, as
    deviations; ``metric`` (n_cells, n_cells): inverse covariance of a recording's.
    """

    measured: Float
    responses: Float
    covariance: Float
    terms: list[tuple[int, int]]
    weights: Float = field(repr=False)
    slopes: Float = field(repr=False)
    spread_slopes: Float = field(repr=False)
    centre: Float = field(repr=False)
    spread: Float = field(repr=False)
    offset: Float = field(repr=False)
    sessions: Float = field(repr=False)
    metric: Float = field(repr=False)

    def deviations(self, cells: Float) -> Float:
        """Return cells (..., n_recordings, n_cells) less those of the rig, in spreads of one recording."""
        return _compressed(cells, self.centre, self.spread) - self.offset

    def statistics(self, deviations: Float) -> Float:
        """Return the statistics of sessions (n_sessions, n_recordings, n_cells) of deviations."""
        return np.asarray(np.einsum("jic,mic->mj", self.weights, deviations))

    def distance(self, measured: Float, simulated: Float) -> float:
        """Return the squared distance of recordings from the mean of sessions; infinite if one failed."""
        left = self.deviations(measured) - self.deviations(simulated).mean(axis=0)
        return float(np.nan_to_num(np.einsum("ic,cd,id", left, self.metric, left), nan=np.inf))

    def linearised(self, sizes: Float) -> tuple[Float, Float]:
        """Return statistics and responses (n_statistics, n_changes), linear around sizes (from 0)."""
        measured, responses = self.measured.copy(), np.zeros((len(self.measured), len(sizes)))
        for k, (change, power) in enumerate(self.terms):
            size = sizes[change]
            responses[:, change] += self.responses[:, k] * (1.0 if power == 1 else 2 * size)
            if power == 2:
                measured += self.responses[:, k] * size**2
        return measured, responses


def project(measured: Float, base: Float, changes: Sequence[Change], floors: Float) -> Projection:
    """Project measured recordings (n_recordings, n_cells) on the responses of a rig.

    ``base`` (n_sessions, n_recordings, n_cells) are simulated sessions of the rig, NaN where a simulation
    failed; ``changes`` have the random numbers of the first of them; ``floors`` (n_cells,) are the smallest
    spreads that matter. Weights of one half of the pairs multiply the responses of the other half, and the
    covariance is that of sessions other than those which whiten: noise counts neither as response nor as
    certainty.
    """
    usable = np.asarray(np.isfinite(base).all(axis=(1, 2)))
    centre = base[usable].mean(axis=0)
    variance = ((base[usable] - centre) ** 2).sum(axis=(0, 1)) / ((usable.sum() - 1) * len(measured))
    spread = np.hypot(np.sqrt(variance), floors)
    offset = _compressed(base[usable], centre, spread).mean(axis=0)

    def deviations(cells: Float) -> Float:
        return np.asarray(_compressed(cells, centre, spread) - offset)

    sessions = deviations(base)
    deviating = [change._replace(cells=deviations(change.cells)) for change in changes]
    terms, halves, noise, spread_slopes = _measure_responses(deviating, sessions, usable)
    sessions = sessions[usable]
    n_recordings, n_cells = measured.shape
    ridge = np.median(noise, axis=0) if noise else np.zeros(n_cells)

    def precision(part: Float) -> Float:
        covariance = ledoit_wolf(part.reshape(-1, n_cells), assume_centered=True)[0]
        return np.asarray(np.linalg.inv(covariance * len(part) / (len(part) - 1) + np.diag(ridge)))

    first, second = np.moveaxis(np.array(halves).reshape(-1, 2, n_recordings, n_cells), 1, 0)
    mean, metric = (first + second) / 2, precision(sessions)
    scale = np.sqrt(np.maximum(np.einsum("jic,cd,jid->j", mean, metric, mean), _NO_RESPONSE))[:, None, None]
    by_first, by_second = first @ metric / scale, second @ metric / scale
    crossed = np.einsum("jic,kic->jk", by_first, second) + np.einsum("jic,kic->jk", by_second, first)
    weights = (by_first + by_second) / 2
    scores = np.empty((len(sessions), n_recordings, len(terms)))
    odd = np.arange(len(sessions)) % 2 == 1
    for part in (odd, ~odd):
        of_others = mean @ precision(sessions[~part]) / scale
        scores[part] = np.einsum("jic,mic->mij", of_others, sessions[part])
    scores -= scores.mean(axis=0)
    # Recordings are independent: their covariances add up.
    covariance = np.einsum("mij,mik->jk", scores, scores) / (len(scores) - 1) * (1 + 1 / len(scores))
    covariance = (1 - _DIAGONAL) * covariance + _DIAGONAL * np.diag(np.diag(covariance))
    slopes = np.zeros((len(changes), n_cells))
    for (k, power), response in zip(terms, mean, strict=True):
        if power == 1:
            slopes[k] = response.mean(axis=0)
    of_measured = np.einsum("jic,ic->j", weights, deviations(measured))
    return Projection(
        of_measured, crossed / 2, covariance, terms, weights, slopes, spread_slopes, centre, spread, offset,
        sessions, metric,
    )  # fmt: skip


def _measure_responses(
    changes: Sequence[Change], sessions: Float, usable: NDArray[np.bool_]
) -> tuple[list[tuple[int, int]], list[list[Float]], list[Float], Float]:
    """Return change and power of each response, its means over two halves of the pairs, noise, spread slopes.

    Changes have deviations as their cells; ``sessions`` are those without a change.
    """
    terms: list[tuple[int, int]] = []
    halves: list[list[Float]] = []
    noise: list[Float] = []
    spread_slopes = np.zeros((len(changes), sessions.shape[-1]))
    for k, (changed, places) in enumerate(changes):
        complete = np.asarray(np.isfinite(changed).all(axis=(0, 2, 3)))
        paired = np.flatnonzero(complete & usable[: changed.shape[1]])
        changed, unchanged = changed[:, paired], sessions[: changed.shape[1]][paired]
        pairs = changed - unchanged
        if pairs.shape[1] < 2 or np.abs(pairs).max() < _NO_RESPONSE:
            continue
        wider = log_spreads(changed[0]) - log_spreads(unchanged)
        noise_share = (
            wider.var(axis=0, ddof=1) / len(wider) / np.maximum(wider.mean(axis=0) ** 2, _NO_RESPONSE)
        )
        spread_slopes[k] = wider.mean(axis=0) * np.clip(1 - noise_share, 0, None) / places[0]
        # Slope, and curvature where there are two places.
        powers = [pairs[0] / places[0]]
        if len(places) == 2:
            powers.append((powers[0] - pairs[1] / places[1]) / (places[0] - places[1]))
            powers[0] = powers[0] - powers[1] * places[0]
        for power, of_pairs in enumerate(powers, start=1):
            half = len(of_pairs) // 2
            parts = np.array([_shrunk_mean(part)[0] for part in (of_pairs[:half], of_pairs[half:])])
            if power == 2:
                # What the halves have in common; the rest is noise, which would hold a size where it is.
                share = np.sum(parts[0] * parts[1]) / np.sum(parts.mean(axis=0) ** 2)
                if share <= 0:
                    continue
                parts *= share
            halves.append([*parts])
            terms.append((k, power))
            if power == 1:
                noise.append(_shrunk_mean(of_pairs)[1] * places[0] ** 2)
    return terms, halves, noise, spread_slopes


def log_spreads(deviations: Float) -> Float:
    """Return the logarithm of the spread over recordings, shape (..., n_cells)."""
    return np.asarray(np.log(deviations.std(axis=-2) + _SMALLEST_SPREAD))


def estimate_by_spreads(projection: Projection, change: int, deviations: Float) -> tuple[float, float]:
    """Estimate a change, with its error, from spreads between recordings (n_recordings, n_cells)."""
    slopes, simulated = projection.spread_slopes[change], log_spreads(projection.sessions)
    mean = simulated.mean(axis=0)
    weights = slopes / (simulated.var(axis=0) + _SMALLEST_SPREAD**2)
    weights /= max(float(weights @ slopes), _NO_RESPONSE)
    error = np.std((simulated - mean) @ weights, ddof=1) * np.sqrt(1 + 1 / len(simulated))
    return float((log_spreads(deviations) - mean) @ weights), float(error)


def _compressed(cells: Float, centre: Float, spread: Float) -> Float:
    return np.asarray(_LINEAR * np.arcsinh((cells - centre) / spread / _LINEAR))


def _shrunk_mean(pairs: Float) -> tuple[Float, Float]:
    """Return means of pairs by recording, drawn to that of all (empirical Bayes), and variance by cell."""
    mean = pairs.mean(axis=0)
    noise = pairs.var(axis=0, ddof=1).mean(axis=0) / len(pairs) if len(pairs) > 1 else np.zeros(mean.shape[1])
    between = np.maximum(mean.var(axis=0, ddof=1) - noise, 0) if len(mean) > 1 else np.zeros(mean.shape[1])
    share = between / (between + noise + 1e-12)
    of_all = mean.mean(axis=0)
    return of_all + share * (mean - of_all), noise * (share + (1 - share) / len(mean))
