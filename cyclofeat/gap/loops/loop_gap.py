"""The gap in torque-deflection loops: missing clearance, friction and compliance of a drive's model."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import differential_evolution
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.utils.validation import check_is_fitted

from cyclofeat._base.checks import different_names
from cyclofeat._base.displays import data_frame
from cyclofeat._base.sklearn_private import Interval, fit_context
from cyclofeat.gap.loops.parts import (
    LARGEST_TORQUE,
    centre_loop,
    checked_loop,
    contact_deflection,
    elastic_torque,
    evenly_spaced,
    relative_error,
    without_effects,
)
from cyclofeat.gap.published.scores import fewest_units, sign_flip_p
from cyclofeat.simulators import CycloidalGearbox

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]

_MOST_EFFECTS = 3  # of a subset
_STAGES = 8  # friction elements that share the Coulomb friction

# Bounds of the parameters of each effect, which are fitted on a logarithmic scale.
LOOP_EFFECTS: dict[str, dict[str, tuple[float, float]]] = {
    "clearance": {"clearance": (1e-6, 4e-4)},
    "friction": {"coulomb_nm": (0.01, 10.0), "spread": (0.01, 1.0), "load_share": (1e-3, 0.9)},
    "torsional_compliance": {"stiffness": (30.0, 1e5)},
    "contact_stiffness_scale": {"factor": (0.35, 20.0)},
}


@dataclass(frozen=True)
class Subset:
    """A set of effects and how it predicts loops that it was not fitted on.

    Effects in the order of ``LOOP_EFFECTS`` (none is the model alone), and the relative error
    (:func:`relative_error`) on the loops held out: its mean over the transfers, and that of each.
    """

    effects: tuple[str, ...]
    error: float
    errors: tuple[float, ...]


@dataclass(eq=False, repr=False)
class LoopModel(RegressorMixin, BaseEstimator):
    r"""Torque-deflection loops of a held drive: contacts, play, friction and compliance in series.

    .. math:: x = \frac{1}{8} \sum_{i=1}^{8} \left( x_c(E_i / s; c) + E_i / k \right),

    with the contacts' deflection x_c for the clearance c (:func:`contact_deflection`), s the factor on their
    stiffness, k the torsional stiffness of housing and shafts in series, and E_i the torque behind friction
    (:func:`elastic_torque`). Friction does not hold all of the drive at once: its Coulomb part is spread
    evenly over T_c (1 - ``spread``) to T_c (1 + ``spread``) among eight equal stages in series (a sum of
    play operators, after Prandtl and Ishlinskii), which rounds the loop's corners. Everything is slow: no
    inertia, no creep.

    Parameters
    ----------
    effects : sequence of str, default=("clearance", "friction", "torsional_compliance")
        Which of ``"clearance"``, ``"friction"``, ``"torsional_compliance"`` and
        ``"contact_stiffness_scale"`` the model has. None: the frictionless drive without clearance.
    gearbox : CycloidalGearbox, optional
        Geometry and contacts. Default: ``CycloidalGearbox.printed_14_pin()``.
    n_points : int, default=120
        Points of each loop that the fit looks at, evenly spaced along its torque.
    max_iter : int, default=40
        Generations of the search.
    random_state : int, RandomState instance or None, default=None
        Seed of the search.

    Attributes
    ----------
    theta_ : dict from "effect.parameter" to float
    at_bound_ : dict from "effect.parameter" to bool
        Whether the fit ended at the edge of what is allowed.
    loss_ : float
        Mean relative error of the loops fitted.
    gearbox_ : CycloidalGearbox
        The drive with what :func:`cyclofeat.simulators.torque_deflection` can hold of the effects:
        clearances, compliance as ``meter_stiffness``, Coulomb friction as ``input_bearing_torque``. Its
        spread and the load's share of it have no parameter there and are left out.

    Notes
    -----
    The fit minimises the mean relative error of the loops (:func:`relative_error`) by differential evolution
    over the logarithms of the parameters, because play makes the error a rough function.

    Examples
    --------
    >>> from cyclofeat.datasets import load_jelmerv_cycloidal
    >>> loop = load_jelmerv_cycloidal().loops[2]
    >>> model = LoopModel(("friction", "torsional_compliance"), max_iter=3, random_state=0).fit([loop])
    >>> 100 < model.theta_["torsional_compliance.stiffness"] < 1000
    True
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        "effects": [list, tuple],
        "gearbox": [CycloidalGearbox, None],
        "n_points": [Interval(Integral, 20, None, closed="left")],
        "max_iter": [Interval(Integral, 1, None, closed="left")],
        "random_state": ["random_state"],
    }

    effects: Sequence[str] = ("clearance", "friction", "torsional_compliance")
    gearbox: CycloidalGearbox | None = None
    n_points: int = 120
    max_iter: int = 40
    random_state: Any = None

    @fit_context(prefer_skip_nested_validation=True)
    def fit(self, loops: Sequence[Any], y: Any = None) -> Self:
        """Fit the effects' parameters to loops of one drive in one state.

        Parameters
        ----------
        loops : sequence
            Each with ``torque`` and ``deflection``, shape (n,), in Nm and rad: one cycle, from and to about
            zero torque, as :func:`cyclofeat.datasets.load_jelmerv_cycloidal` gives them.
        y : ignored

        Returns
        -------
        self : LoopModel

        Raises
        ------
        ValueError
            If an effect is unknown, there is no loop, a loop is no cycle, or its torque is too large.
        """
        names = _in_order(self.effects, "effects") if self.effects else ()
        pairs = self._loop_pairs(loops)
        self.plain_ = CycloidalGearbox.printed_14_pin() if self.gearbox is None else self.gearbox
        bounds = {f"{name}.{p}": b for name in names for p, b in LOOP_EFFECTS[name].items()}
        peak, factor = max(float(np.abs(t).max()) for t, _ in pairs), "contact_stiffness_scale.factor"
        softest, hardest = bounds.get(factor, (1.0, 1.0))
        if peak > LARGEST_TORQUE * hardest:
            raise ValueError(
                f"loops must not exceed {LARGEST_TORQUE * hardest:g} Nm, at which the contacts' curve ends, "
                f"got {peak:.4g} Nm"
            )
        if factor in bounds:
            bounds[factor] = (max(softest, peak / LARGEST_TORQUE), hardest)
        parameters = list(bounds.items())

        def error(logs: Float) -> Float:
            theta = {name: np.exp(v) for (name, _), v in zip(parameters, logs, strict=True)}
            errors = [relative_error(x, self._centred_deflection(t, theta)) for t, x in pairs]
            return np.asarray(np.mean(errors, axis=0))

        if parameters:
            ends = [(math.log(low), math.log(high)) for _, (low, high) in parameters]
            search = differential_evolution(
                error, ends, maxiter=self.max_iter, popsize=12, tol=1e-4, seed=self.random_state,
                init="sobol", vectorized=True, updating="deferred", polish=False,
            )  # fmt: skip
            best, self.loss_ = search.x, float(search.fun)
        else:
            best, self.loss_ = np.zeros(0), float(error(np.zeros(0)))
        self.theta_ = {name: math.exp(v) for (name, _), v in zip(parameters, best, strict=True)}
        self.at_bound_ = {
            name: bool(min(v - math.log(low), math.log(high) - v) < 0.01 * math.log(high / low))
            for (name, (low, high)), v in zip(parameters, best, strict=True)
        }
        clearance = self.theta_.get("clearance.clearance", 0.0)
        self.gearbox_ = without_effects(self.plain_).replace(
            clearance=clearance,
            pin_clearance=clearance,
            stiffness_scale=self.plain_.stiffness_scale * self.theta_.get(factor, 1.0),
            input_bearing_torque=self.theta_.get("friction.coulomb_nm", 0.0) / self.plain_.n_lobes,
            meter_stiffness=self.theta_.get("torsional_compliance.stiffness", 0.0),
        )
        return self

    def score(self, loops: Sequence[Any], y: Any = None, sample_weight: Any = None) -> float:
        """Minus the mean relative error of loops (:func:`relative_error`): higher is better.

        Parameters
        ----------
        loops : sequence
            See :meth:`fit`.
        y, sample_weight : ignored

        Returns
        -------
        float
        """
        check_is_fitted(self)
        return -float(np.mean([relative_error(x, self.predict(t)) for t, x in self._loop_pairs(loops)]))

    def predict(self, torque: ArrayLike) -> Float:
        """Deflection over a cycle of torque, zero between its extremes.

        Parameters
        ----------
        torque : array-like, shape (n,)
            In Nm.

        Returns
        -------
        ndarray, shape (n,)
            In rad.
        """
        check_is_fitted(self)
        return centre_loop(self._centred_deflection(np.asarray(torque, dtype=np.float64), self.theta_))

    def _loop_pairs(self, loops: Sequence[Any]) -> list[tuple[Float, Float]]:
        """Check loops; return the torque and deflection of each at evenly spaced points."""
        pairs = [evenly_spaced(*checked_loop(loop.torque, loop.deflection), self.n_points) for loop in loops]
        if not pairs:
            raise ValueError("loops must hold at least one loop, got none")
        return pairs

    def _centred_deflection(self, torque: Float, theta: Mapping[str, Any]) -> Float:
        """Deflections (..., n) with parameters of shape (...)."""
        coulomb, spread, share, clearance, factor, stiffness = (
            np.asarray(theta.get(name, neutral), dtype=np.float64)[..., np.newaxis]
            for name, neutral in (
                ("friction.coulomb_nm", 0.0), ("friction.spread", 0.0), ("friction.load_share", 0.0),
                ("clearance.clearance", 0.0), ("contact_stiffness_scale.factor", 1.0),
                ("torsional_compliance.stiffness", math.inf),
            )
        )  # fmt: skip
        place = (2 * np.arange(_STAGES) + 1) / _STAGES - 1
        elastic = elastic_torque(torque, coulomb * (1 + spread * place), share)
        x = contact_deflection(self.plain_, elastic, clearance, factor) + elastic / stiffness[..., np.newaxis]
        return np.asarray(x.mean(axis=-2))


@dataclass(frozen=True)
class LoopGap:
    """Result of :func:`find_loop_gap`.

    Attributes
    ----------
    subsets : tuple of Subset
        All that were tried, smallest error first.
    effects : tuple of str
        The effects named.
    p_without : mapping from str to float
        One-sided sign-flip p over the transfers that the model with an effect predicts no better than the one
        without it, for each named effect; never below 2^-n.
    look_alikes : tuple of tuple of str
        Other subsets of as many effects that predict as well, as far as the transfers tell.
    models : mapping from tuple of str to list of LoopModel
        The fitted models of each subset, one per transfer.
    warnings : tuple of str
        Warning of transfers that are too few to name an effect.
    """

    subsets: tuple[Subset, ...]
    effects: tuple[str, ...]
    p_without: Mapping[str, float]
    look_alikes: tuple[tuple[str, ...], ...]
    models: Mapping[tuple[str, ...], Sequence[LoopModel]] = field(repr=False)
    warnings: tuple[str, ...] = ()

    def to_frame(self) -> pd.DataFrame:
        """Return the subsets as a data frame: effects, mean error, error of each transfer; needs pandas."""
        rows = [
            {"effects": ", ".join(subset.effects), "error": subset.error}
            | {f"error of transfer {k}": error for k, error in enumerate(subset.errors)}
            for subset in self.subsets
        ]
        return data_frame(rows)


def find_loop_gap(
    transfers: Sequence[tuple[Sequence[Any], Sequence[Any]]],
    *,
    model: LoopModel | None = None,
    library: Sequence[str] | None = None,
    alpha: float = 0.05,
) -> LoopGap:
    """Find the effects that a drive's model needs to predict loops it was not fitted on.

    The smallest subset of ``library`` of up to three effects that predicts held-out loops no worse than the
    best subset is named.

    Parameters
    ----------
    transfers : sequence of (loops, loops)
        Loops to fit and loops to predict, of one drive in one state each, 2 to 20 of them.
    model : LoopModel, optional
        Gearbox and settings of the fits; its effects are replaced.
    library : sequence of str, optional
        Names of ``LOOP_EFFECTS``. Default: all four.
    alpha : float, default=0.05
        One-sided sign-flip p over the transfers up to which a larger subset counts as better.

    Returns
    -------
    LoopGap

    Raises
    ------
    ValueError
        If there are too few or too many transfers, or the library names an unknown effect.

    Notes
    -----
    The p over n transfers is never below 2^-n, so at the default ``alpha`` at least 5 are needed to name an
    effect.

    The search begins with the subset of the smallest mean error, if that predicts significantly better than
    no effect. It then removes effects as long as the others do not predict worse. It does not begin with
    single effects, because some have an influence only together.
    """
    n, fewest = len(transfers), fewest_units(alpha)
    if not 2 <= n <= 20:
        raise ValueError(f"transfers must be 2 to 20 pairs of loops, got {n}")
    warning = (
        f"{n} transfers: no effect can be named, as p over them is never below {2.0**-n:.2g} and alpha is "
        f"{alpha:g}; it takes at least {fewest}"
    )
    names = tuple(LOOP_EFFECTS) if library is None else _in_order(library, "library")
    plain = LoopModel() if model is None else model
    models: dict[tuple[str, ...], list[LoopModel]] = {}
    errors: dict[tuple[str, ...], Float] = {}
    for size in range(min(_MOST_EFFECTS, len(names)) + 1):
        for effects in itertools.combinations(names, size):
            models[effects] = [
                clone(plain).set_params(effects=effects).fit(fitted) for fitted, _ in transfers
            ]
            scores = [fit.score(held) for fit, (_, held) in zip(models[effects], transfers, strict=True)]
            errors[effects] = -np.array(scores)
    subsets = sorted(
        (Subset(k, float(v.mean()), tuple(v.tolist())) for k, v in errors.items()),
        key=lambda subset: subset.error,
    )
    # Backward: play has an influence only behind friction, and friction only before a compliance.
    named = subsets[0].effects
    if named and sign_flip_p(errors[()] - errors[named], "greater") > alpha:
        named = ()
    while named:
        fewer = [_subset_without(named, name) for name in named]
        best = min(fewer, key=lambda key: float(errors[key].mean()))
        if sign_flip_p(errors[best] - errors[named], "greater") <= alpha:
            break
        named = best
    return LoopGap(
        subsets=tuple(subsets),
        effects=named,
        p_without={
            name: sign_flip_p(errors[_subset_without(named, name)] - errors[named], "greater")
            for name in named
        },
        look_alikes=tuple(
            subset.effects
            for subset in subsets
            if subset.effects != named
            and len(subset.effects) == len(named)
            and sign_flip_p(errors[subset.effects] - errors[named]) > alpha
        ),
        models=models,
        warnings=(warning,) if n < fewest else (),
    )


def _subset_without(named: tuple[str, ...], name: str) -> tuple[str, ...]:
    return tuple(other for other in named if other != name)


def _in_order(effects: Sequence[str], argument: str) -> tuple[str, ...]:
    given = different_names(effects, LOOP_EFFECTS, argument)
    return tuple(name for name in LOOP_EFFECTS if name in given)
