"""Joint posterior of all missing effects, learned from simulated rigs."""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit
from scipy.stats import norm
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from cyclofeat._base.checks import whole
from cyclofeat._base.files import write_whole
from cyclofeat._base.quantities import in_words
from cyclofeat.gap.posterior.answers import (
    NAMED,
    detection_limit,
    reach_beyond,
    strengths_of,
    visible_ends,
    with_look_alikes,
)
from cyclofeat.gap.posterior.calibration import (
    FEWEST_LEARNED,
    QUANTILES,
    mean_coefficients,
    mean_predictors,
    quantiles_of,
    slopes_of,
    spread_power,
)
from cyclofeat.gap.posterior.inputs import Inputs, Reference, Single, inputs_of_sessions, recording_arrays
from cyclofeat.gap.posterior.network import (
    NetworkWeights,
    Targets,
    network_outputs,
    random_inputs,
    select_outputs,
    split_outputs,
    train_network,
)
from cyclofeat.gap.world.world import Rigs, Session, World
from cyclofeat.simulators.effects import EffectParameter

Float = NDArray[np.float64]

DEFAULT = Path(__file__).with_name("default.npz")
_FORMAT = "cyclofeat effect posterior 5"
_CALIBRATING = 0.15  # share of the machines that calibrates probabilities and intervals
_PLENTY = 1500  # machines that suffice for that
_SEEN = 0.5  # share of the rigs with an effect of a size in which it is named, from which that size is seen
_AT_A_TIME = 500
_EPOCHS = 40, 12  # of networks that begin anew, and of those that go on


@dataclass(frozen=True)
class Guess:
    """Statements of a posterior about one session, by name of effect or of parameter."""

    presence: dict[str, float]  # probability of each effect; NaN for one not learned
    # Probability that it is there and so large that half of the simulated rigs with it are named; NaN for an
    # effect that no size shows.
    visible: dict[str, float]
    # 0.05, 0.25, 0.5, 0.75 and 0.95 quantile of each parameter if its effect is present, in its unit.
    sizes: dict[str, Float]
    fitted: dict[str, Float]  # median and standard deviation of each, on the scale of its fit


@dataclass(eq=False, repr=False)
class EffectPosterior(BaseEstimator):
    """Probability of each effect and distribution of its size, given the recordings of a rig.

    The summaries of recordings become deviations from those of a rig without missing effects at the same
    speed, load and count. A network that takes them in any number and order learns the presence of each
    effect and mean and spread of each size. Probabilities are calibrated, and intervals widened or narrowed,
    on machines that the network has not seen.

    Parameters
    ----------
    n_networks : int, default=2
        Networks that differ in their random numbers; their answers are averaged.
    epochs : int, optional
        In each, every rig is shown once, as a random session: 4 or more of its recordings, with counts and
        tachometer or without. Default: 40, and 12 with a ``start``, because with more they fit single rigs.
    random_state : int, default=0

    Attributes
    ----------
    names_, size_names_, cells_ : tuple of str
        Names of the effects, sizes and cells of the rigs.
    reference_ : Reference
        Summaries without an effect.
    networks_ : list of dict from str to ndarray
        Weights of each network, by layer.
    learned_ : ndarray of bool, shape (n_effects,)
        False for an effect that fewer than 20 machines have, or lack.
    limits_ : ndarray, shape (n_effects,)
        Strength of each effect's main parameter, its distance from neutral on the scale of its fit, from
        which half of the rigs with the effect are named, itself or a look-alike; NaN where no strength
        suffices.
    spread_power_ : float
        Power of the networks' spreads of sizes to which those of their errors are proportional.
    n_rigs_ : int
        Simulated rigs that it has learned from, with those of a start of the same model and quantity.

    See Also
    --------
    cyclofeat.gap.prepare_world : Simulates the rigs.

    Notes
    -----
    Training needs JAX and Optax (the extra ``prepare``); answers need numpy alone.

    Probabilities and intervals hold on average over rigs of the world that it was fitted to, and for sessions
    like those. Whether a rig is one of that world is not asked.
    """

    n_networks: int = 2
    epochs: int | None = None
    random_state: int = 0

    def fit(
        self,
        rigs: Rigs,
        y: None = None,
        *,
        start: EffectPosterior | None = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> EffectPosterior:
        """Learn from simulated rigs.

        Parameters
        ----------
        rigs : Rigs
        y : None
            Not used.
        start : EffectPosterior, optional
            Its networks go on learning, in the place of random ones: what they know of effects that both have
            is kept, and fewer rigs suffice. It may be of another gearbox or of the other torque; kinds of
            summaries, and counts, must be the same.
        progress : callable, optional
            Called after each epoch with the number done and their total.

        Returns
        -------
        EffectPosterior

        Raises
        ------
        ImportError
            If JAX or Optax is not installed.
        ValueError
            If a parameter is invalid, there are too few rigs without an effect, or ``start`` has other
            summaries or counts, or fewer networks.
        """
        epochs = _EPOCHS[start is not None] if self.epochs is None else whole("epochs", self.epochs, 1)
        n_networks = whole("n_networks", self.n_networks, 1)
        self.names_, self.size_names_, self.cells_ = rigs.names, rigs.size_names, rigs.cells
        self.logarithmic_, self.world_, self.n_rigs_ = rigs.logarithmic, rigs.world, len(rigs)
        random = np.random.default_rng(self.random_state)
        machines = np.unique(rigs.machines)
        n_calibrating = min(max(round(_CALIBRATING * machines.size), 1), _PLENTY)
        calibrating = random.permutation(machines)[:n_calibrating]
        held = np.isin(rigs.machines, calibrating)
        self.reference_ = Reference().fit(rigs)
        self._fit_scales(rigs)
        start_weights: list[NetworkWeights | None] = [None] * n_networks
        if start is not None:
            start_weights[:] = self._continue_from(start, random)
            if all(start.world_.get(key) == rigs.world.get(key) for key in ("rig", "quantity")):
                self.n_rigs_ += start.n_rigs_
        recordings = recording_arrays(
            rigs.values, rigs.conditions, rigs.counts, rigs.speeds, self.reference_, rigs.cells
        )
        sizes = (rigs.sizes - self.size_mean_) / self.size_spread_
        rows = np.flatnonzero(~held)

        def epoch_progress(network: int) -> Callable[[int, int], object] | None:
            if progress is None:
                return None
            return lambda epoch, _: progress(network * epochs + epoch, n_networks * epochs)

        self.networks_ = [
            train_network(
                recordings.of(rows), Targets(rigs.present[rows], sizes[rows]), self.reference_, epochs=epochs,
                random_state=self.random_state + k, start=start_weights[k], progress=epoch_progress(k),
            )
            for k in range(n_networks)
        ]  # fmt: skip
        rows = np.flatnonzero(held)
        self.spread_power_ = 1.0
        inputs, causes = random_inputs(recordings.of(rows), self.reference_, random)
        logits, mean, spread = self._network_outputs(inputs)
        self.slopes_ = slopes_of(logits, rigs.present[rows])
        predictors = mean_predictors(logits, causes, self.names_)
        self.mean_coefficients_ = mean_coefficients(predictors, rigs.present[rows], self.names_)
        errors = sizes[rows] - mean
        self.spread_power_ = spread_power(errors, spread)
        self.size_quantiles_ = quantiles_of(errors / spread**self.spread_power_)
        probabilities = np.nan_to_num(self._calibrated_probabilities(logits, causes))
        named = with_look_alikes(probabilities, self.names_) > NAMED
        self.limits_ = np.full(len(self.names_), np.nan)
        for k, column, parameter in self._main_parameters():
            true = rigs.sizes[rows, column]
            having = np.isfinite(true)
            strengths = strengths_of(parameter, true[having])
            self.limits_[k] = detection_limit(strengths, named[having, k], _SEEN)
        return self

    def _main_parameters(self) -> list[tuple[int, int, EffectParameter]]:
        """Column of each effect, column of its main parameter, and this parameter."""
        if not self.world_:
            return []
        rows = []
        for effect in self.world.effects or ():
            name = effect.main_parameter
            column = self.size_names_.index(f"{effect.effect_id}.{name}")
            rows.append((self.names_.index(effect.effect_id), column, effect.parameters[name]))
        return rows

    def _continue_from(self, start: EffectPosterior, random: np.random.Generator) -> list[NetworkWeights]:
        """Take over the scales of ``start``, and return its networks with the outputs of this posterior."""
        check_start(start, self.cells_, self.reference_.counts_.tolist())
        if len(start.networks_) < self.n_networks:
            raise ValueError(f"start must have {self.n_networks} networks, got {len(start.networks_)}")
        places = {name: k for k, name in enumerate(start.names_)}
        of_sizes = {name: k for k, name in enumerate(start.size_names_)}
        sizes = np.array([of_sizes.get(name, -1) for name in self.size_names_])
        known = sizes >= 0
        self.size_mean_[known] = start.size_mean_[sizes[known]]
        self.size_spread_[known] = start.size_spread_[sizes[known]]
        n, n_sizes = len(start.names_), len(start.size_names_)
        columns = np.concatenate(
            [
                [places.get(name, -1) for name in self.names_],
                np.where(known, n + sizes, -1),
                np.where(known, n + n_sizes + sizes, -1),
            ]
        )
        return [select_outputs(weights, columns, random) for weights in start.networks_[: self.n_networks]]

    def _fit_scales(self, rigs: Rigs) -> None:
        present = rigs.present
        n_with, n_without = (
            np.array([np.unique(rigs.machines[having]).size for having in flags.T])
            for flags in (present, ~present)
        )
        self.learned_ = (n_with >= FEWEST_LEARNED) & (n_without >= FEWEST_LEARNED)
        has_size = np.isfinite(rigs.sizes)
        sums = np.maximum(has_size.sum(axis=0), 1)
        self.size_mean_ = np.nansum(rigs.sizes, axis=0) / sums
        self.size_spread_ = np.sqrt(np.nansum((rigs.sizes - self.size_mean_) ** 2, axis=0) / sums) + 1e-9
        owners = np.array([name.partition(".")[0] for name in self.size_names_])
        self.sizes_learned_ = self.learned_[[self.names_.index(owner) for owner in owners]]

    def __str__(self) -> str:
        if not hasattr(self, "learned_"):
            return repr(self)
        learned = f"{self.learned_.sum()} of {len(self.names_)} effects from {self.n_rigs_} simulated rigs"
        quantity = in_words(self.world.quantity)
        return f"Posterior of missing effects\n  has learned: {learned}\n  quantity: {quantity}"

    @property
    def world(self) -> World:
        """World of the rigs that it has learned from; with its model."""
        check_is_fitted(self, "networks_")
        return World.from_dict(self.world_)

    def predict_proba(self, sessions: Sequence[Session]) -> Float:
        """Return the probability of each effect; NaN for one not learned.

        Parameters
        ----------
        sessions : sequence of Session

        Returns
        -------
        ndarray, shape (n_sessions, n_effects)
        """
        inputs, causes = self._network_inputs(sessions)
        return self._calibrated_probabilities(self._network_outputs(inputs)[0], causes)

    def _calibrated_probabilities(self, logits: Float, causes: Float) -> Float:
        calibrated = self.slopes_ * logits
        known = np.isfinite(self.mean_coefficients_).all(axis=1)
        weights, constants = self.mean_coefficients_[known, :-1], self.mean_coefficients_[known, -1]
        calibrated[:, known] = mean_predictors(logits, causes, self.names_) @ weights.T + constants
        return np.where(self.learned_, expit(calibrated), np.nan)

    @property
    def visible_from(self) -> dict[str, tuple[str, float, float]]:
        """Main parameter of each effect that some size shows, and the values below and above which it does.

        Half of the simulated rigs with it so large are named. NaN on a side on which it grows no stronger.
        """
        check_is_fitted(self, "networks_")
        return {
            self.names_[k]: (
                self.size_names_[column].partition(".")[2],
                *visible_ends(parameter, self.limits_[k]),
            )
            for k, column, parameter in self._main_parameters()
            if np.isfinite(self.limits_[k])
        }

    def guess(self, sessions: Sequence[Session]) -> list[Guess]:
        """Return all that the posterior states about sessions.

        Parameters
        ----------
        sessions : sequence of Session

        Returns
        -------
        list of Guess
        """
        inputs, causes = self._network_inputs(sessions)
        logits, mean, spread = self._network_outputs(inputs)
        presence = self._calibrated_probabilities(logits, causes)
        standardised = mean[:, :, None] + spread[:, :, None] * self.size_quantiles_
        sizes = standardised * self.size_spread_[:, None] + self.size_mean_[:, None]
        logarithmic = np.array(self.logarithmic_)[:, None]
        quantiles = np.where(logarithmic, np.exp(np.where(logarithmic, sizes, 0.0)), sizes)
        quantiles = np.where(self.sizes_learned_[:, None], quantiles, np.nan)
        low, _, middle, _, high = self.size_quantiles_.T
        centre = (mean + spread * middle) * self.size_spread_ + self.size_mean_
        width = spread * ((high - low) / (2 * norm.ppf(QUANTILES[-1]))) * self.size_spread_
        beyond = np.full(logits.shape, np.nan)
        for k, column, parameter in self._main_parameters():
            beyond[:, k] = reach_beyond(parameter, self.limits_[k], centre[:, column], width[:, column])
        visible = presence * beyond
        fitted = np.stack([centre, width], axis=2)
        return [
            Guess(
                *(dict(zip(self.names_, p[k].tolist(), strict=True)) for p in (presence, visible)),
                *(dict(zip(self.size_names_, rows[k], strict=True)) for rows in (quantiles, fitted)),
            )
            for k in range(len(sessions))
        ]

    def presence(self, session: Session) -> dict[str, float]:
        """Return the probability of each effect.

        Parameters
        ----------
        session : Session

        Returns
        -------
        dict from str to float
            By effect, NaN for one that was not learned.
        """
        return self.guess([session])[0].presence

    def _network_inputs(self, sessions: Sequence[Session]) -> Inputs:
        """Return the inputs of sessions; raise ValueError unless they are like those of the world."""
        check_is_fitted(self, "networks_")
        for session in sessions:
            if not len(session.values) or session.values.shape[1] != len(self.cells_):
                raise ValueError(
                    f"session must hold recordings with the {len(self.cells_)} summaries of the world, got "
                    f"shape {session.values.shape}"
                )
            self.reference_.check(session)
        return inputs_of_sessions(sessions, self.reference_, self.cells_)

    def _network_outputs(self, inputs: Mapping[str, Single]) -> tuple[Float, Float, Float]:
        """Return logits, and mean and standard deviation of standardised sizes, of all networks together."""
        parts: list[dict[str, Any]] = [
            {name: values[first : first + _AT_A_TIME] for name, values in inputs.items()}
            for first in range(0, len(inputs["shown"]), _AT_A_TIME)
        ]
        outputs = np.mean(
            [
                np.concatenate([network_outputs(np, weights, part) for part in parts])
                for weights in self.networks_
            ],
            axis=0, dtype=np.float64,
        )  # fmt: skip
        logits, mean, spread = split_outputs(np, outputs, len(self.names_))
        return logits, mean, np.exp(self.spread_power_ * spread)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the posterior to a file (NPZ, no pickle); it appears whole or not at all.

        Weights of the networks are rounded to 16 bits.

        Parameters
        ----------
        path : path

        Returns
        -------
        pathlib.Path
        """
        check_is_fitted(self, "networks_")
        fitted = {name: value for name, value in vars(self).items() if name.endswith("_")}
        networks, reference = fitted.pop("networks_"), fitted.pop("reference_")
        arrays: dict[str, Any] = {k: value for k, value in fitted.items() if isinstance(value, np.ndarray)}
        stated = {name: value for name, value in fitted.items() if name not in arrays}
        stated |= {"format": _FORMAT, **self.get_params()}
        arrays |= {f"reference.{name}": values for name, values in vars(reference).items()}
        for k, weights in enumerate(networks):
            arrays |= {f"network{k}.{name}": values.astype(np.float16) for name, values in weights.items()}
        content = io.BytesIO()
        np.savez_compressed(content, stated=np.array(json.dumps(stated)), **arrays)
        return write_whole(Path(path), lambda stream: stream.write(content.getvalue()))


def load_posterior(path: str | os.PathLike[str] = DEFAULT) -> EffectPosterior:
    """Read a posterior that :meth:`EffectPosterior.save` wrote.

    Parameters
    ----------
    path : path, optional
        Default: the posterior of the default gearbox that comes with the package.

    Returns
    -------
    EffectPosterior

    Raises
    ------
    ValueError
        If the file holds something else.
    """
    stored = io.BytesIO(Path(path).read_bytes())  # so that a broken file is closed
    try:
        with np.load(stored, allow_pickle=False) as file:
            content = dict(file)
        stated = json.loads(str(content.pop("stated")))
        if stated.pop("format") != _FORMAT:
            raise ValueError
    except (ValueError, KeyError, AttributeError, TypeError, zipfile.BadZipFile, EOFError):
        raise ValueError(
            f"{path} holds no posterior of effects that this version reads; "
            "cyclofeat gap --prepare FILE writes one"
        ) from None
    posterior = EffectPosterior(**{name: stated.pop(name) for name in EffectPosterior().get_params()})
    for name, value in stated.items():
        if name.endswith("_"):
            setattr(posterior, name, tuple(value) if isinstance(value, list) else value)
    posterior.reference_ = Reference()
    networks: dict[str, dict[str, Any]] = {}
    for name, values in content.items():
        place, dot, key = name.partition(".")
        if not dot:
            setattr(posterior, name, values)
        elif place == "reference":
            setattr(posterior.reference_, key, values)
        else:
            networks.setdefault(place, {})[key] = values.astype(np.float32)
    posterior.networks_ = [networks[name] for name in sorted(networks)]
    return posterior


def check_start(start: EffectPosterior, cells: Sequence[str], counts: Sequence[int]) -> None:
    """Raise ValueError unless a posterior can go on learning from rigs with these summaries and counts.

    Another gearbox or torque is no hindrance: summaries are deviations from those of a rig without effects.
    """
    check_is_fitted(start, "networks_")
    wanted, own = ([cell.partition(":")[0] for cell in names] for names in (cells, start.cells_))
    if own != wanted:
        raise ValueError(
            f"start must have summaries like the {len(wanted)} of the rigs, got one with {len(own)}: "
            "it needs an equal sampling rate"
        )
    known = start.reference_.counts_.tolist()
    if sorted(counts) != known:
        raise ValueError(
            f"start must have learned counts of {sorted(counts)}, like the rigs, got one of {known}"
        )
