"""Joint posterior of all missing effects, learned from simulated rigs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from cyclofeat._base.checks import whole
from cyclofeat._base.files import write_whole
from cyclofeat._base.versions import MODEL_PACKAGES, package_versions
from cyclofeat.gap.posterior._learners import QUANTILES, SizeRegressor, enough, fit_presence
from cyclofeat.gap.posterior._pool import pooled
from cyclofeat.gap.posterior._reference import Reference
from cyclofeat.gap.world import Rigs, Session

Float = NDArray[np.float64]

_FORMAT = "cyclofeat effect posterior 1"
_FEWEST_SHOWN = 4


class EffectPosterior(BaseEstimator):
    """Probability of each effect and distribution of its size, given the recordings of a rig.

    The summaries of recordings become deviations from those of a rig without missing effects at the same
    speed, load and count. Their mean, also uncorrelated, their spread and extremes, their difference between
    few and many worn lobes, and a fit of gain and offset describe a session. Gradient-boosted trees with
    calibrated probabilities learn the presence of each effect, others the quantiles of each size.

    Parameters
    ----------
    n_views : int, default=2
        Random sessions of each simulated rig: 4 or more of its recordings, with counts and tachometer or
        without.
    max_iter : int, default=120
        Trees of each classifier and regressor.
    random_state : int, default=0
    n_jobs : int, default=1
        Number of worker processes that fit effects.

    Attributes
    ----------
    names_, size_names_, cells_ : tuple of str
        Of the rigs.
    reference_ : estimator
        Summaries without an effect.
    classifiers_ : dict from str to estimator
        By effect; one that fewer than 20 machines have, or lack, is left out.
    regressors_ : dict from str to estimator
        By parameter; one that fewer than 20 machines have is left out.

    See Also
    --------
    cyclofeat.gap.world.prepare_world : Simulates the rigs.

    Notes
    -----
    Probabilities and intervals hold on average over rigs of the world that it was fitted to, and for sessions
    like those. Whether a rig is one of that world is not asked.
    """

    def __init__(self, n_views: int = 2, max_iter: int = 120, random_state: int = 0, n_jobs: int = 1) -> None:
        self.n_views = n_views
        self.max_iter = max_iter
        self.random_state = random_state
        self.n_jobs = n_jobs

    def fit(self, rigs: Rigs, y: None = None) -> EffectPosterior:
        """Learn from simulated rigs.

        Parameters
        ----------
        rigs : Rigs
        y : None
            Not used.

        Returns
        -------
        EffectPosterior

        Raises
        ------
        ValueError
            If there are too few rigs without an effect.
        """
        whole("n_views", self.n_views, 1)
        whole("max_iter", self.max_iter, 1)
        self.names_, self.size_names_, self.cells_ = rigs.names, rigs.size_names, rigs.cells
        self.logarithmic_ = rigs.logarithmic
        self.reference_ = Reference().fit(rigs)
        random = np.random.default_rng(self.random_state)
        rows = np.repeat(np.arange(len(rigs)), self.n_views)
        X = self._features([random_session(rigs, row, random) for row in rows.tolist()])
        groups, present, sizes = rigs.machines[rows], rigs.present[rows], rigs.sizes[rows]
        learnable = [
            k for k, with_it in enumerate(present.T) if enough(groups[with_it]) and not with_it.all()
        ]
        workers = joblib.Parallel(n_jobs=self.n_jobs)
        classifiers = workers(
            joblib.delayed(fit_presence)(X, present[:, k], groups, self.max_iter, self.random_state)
            for k in learnable
        )
        self.classifiers_ = dict(zip([self.names_[k] for k in learnable], classifiers, strict=True))
        having = {name: np.isfinite(sizes[:, k]) for k, name in enumerate(self.size_names_)}
        having = {name: rows for name, rows in having.items() if enough(groups[rows])}
        regressors = workers(
            joblib.delayed(SizeRegressor(self.max_iter, self.random_state).fit)(
                X[rows], sizes[rows, self.size_names_.index(name)], groups[rows]
            )
            for name, rows in having.items()
        )
        self.regressors_ = dict(zip(having, regressors, strict=True))
        return self

    def predict_proba(self, sessions: Sequence[Session]) -> Float:
        """Return the probability of each effect, shape (n_sessions, n_effects); NaN for one not learned."""
        X = self._features(sessions)
        probabilities = np.full((len(X), len(self.names_)), np.nan)
        for name, classifier in self.classifiers_.items():
            probabilities[:, self.names_.index(name)] = classifier.predict_proba(X)[:, 1]
        return probabilities

    def predict_quantiles(self, sessions: Sequence[Session]) -> Float:
        """Return quantiles of each parameter if its effect is present, in the parameter's unit.

        Returns
        -------
        ndarray, shape (n_sessions, n_sizes, 5)
            0.05, 0.25, 0.5, 0.75 and 0.95 quantile; NaN for a parameter not learned.
        """
        X = self._features(sessions)
        quantiles = np.full((len(X), len(self.size_names_), len(QUANTILES)), np.nan)
        for name, regressor in self.regressors_.items():
            k = self.size_names_.index(name)
            found = regressor.predict(X)
            quantiles[:, k] = np.exp(found) if self.logarithmic_[k] else found
        return quantiles

    def presence(self, session: Session) -> dict[str, float]:
        """Return the probability of each effect."""
        probabilities = self.predict_proba([session])[0].tolist()
        return dict(zip(self.names_, probabilities, strict=True))

    def sizes(self, session: Session) -> dict[str, Float]:
        """Return the five quantiles of each parameter if its effect is present, in the parameter's unit."""
        quantiles = self.predict_quantiles([session])[0]
        return dict(zip(self.size_names_, quantiles, strict=True))

    def _features(self, sessions: Sequence[Session]) -> Float:
        check_is_fitted(self, "reference_")
        for session in sessions:
            if not len(session.values) or session.values.shape[1] != len(self.cells_):
                raise ValueError(
                    f"session must hold recordings with the {len(self.cells_)} summaries of the world, got "
                    f"shape {session.values.shape}"
                )
            self.reference_.check(session)
        return pooled(sessions, self.reference_, self.cells_)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the posterior to a file, a pickle; it appears whole or not at all.

        Parameters
        ----------
        path : path
        """
        check_is_fitted(self, "regressors_")
        content = {"format": _FORMAT, "made_with": package_versions(*MODEL_PACKAGES), "posterior": self}
        return write_whole(Path(path), lambda stream: joblib.dump(content, stream, compress=3))


def load_posterior(path: str | os.PathLike[str], *, trusted: bool = False) -> EffectPosterior:
    """Read a posterior that :meth:`EffectPosterior.save` wrote.

    Parameters
    ----------
    path : path
    trusted : bool, default=False
        Whether the file comes from a trusted source: a pickle can run any code when loaded.

    Raises
    ------
    ValueError
        If the file is not trusted, holds something else, or was written by other versions.
    """
    if not trusted:
        raise ValueError(
            f"{path} is a pickle, which can run any code when loaded: if you trust where it comes from, load "
            "it with trusted=True"
        )
    content: Any = joblib.load(path)
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise ValueError(f"{path} holds no posterior of effects")
    now = package_versions(*MODEL_PACKAGES)
    if different := [name for name, version in content["made_with"].items() if now.get(name) != version]:
        raise ValueError(f"{path} was written by other versions of {', '.join(different)}: fit it again")
    posterior: EffectPosterior = content["posterior"]
    return posterior


def random_session(rigs: Rigs, rig: int, random: np.random.Generator) -> Session:
    """Return some recordings of a rig in random order, with counts and tachometer or without."""
    n_recordings = rigs.values.shape[1]
    n_shown = int(random.integers(min(_FEWEST_SHOWN, n_recordings), n_recordings + 1))
    shown = random.permutation(np.flatnonzero(np.isfinite(rigs.values[rig, :, 0])))[:n_shown]
    counts, tachometer = random.random(2) < 0.5
    return rigs.session(rig, shown, counts=bool(counts), tachometer=bool(tachometer))
