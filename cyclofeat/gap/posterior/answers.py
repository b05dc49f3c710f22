"""From probabilities to answers: the state of an effect, look-alikes, sizes detected."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import logit
from scipy.stats import norm
from sklearn.linear_model import LogisticRegression

from cyclofeat.simulators.effects import EffectParameter
from cyclofeat.simulators.effects.library import look_alikes

Float = NDArray[np.float64]
State = Literal["missing", "probably missing", "undecided", "too small to matter", "not missing"]

PRESENT, ABSENT = 0.95, 0.05  # probabilities from which an effect is missing, and up to which it is not
NAMED = 0.5
# An undecided effect is too small to matter up to this probability of being there and visible.
UNSEEN = 0.02


def state_of(probability: float, visible: float = math.nan, *, named: bool = False) -> State:
    """Return the word for an effect that is missing in the model with this probability.

    ``visible`` is the probability that it is missing and large enough to be seen (NaN: not known); ``named``
    effects stand for their look-alikes although their own probability is below one half.

    Examples
    --------
    >>> state_of(0.97), state_of(0.21, named=True), state_of(0.21), state_of(0.21, visible=0.01)
    ('missing', 'probably missing', 'undecided', 'too small to matter')
    """
    if probability >= PRESENT:
        return "missing"
    if named or probability >= NAMED:
        return "probably missing"
    if probability <= ABSENT:
        return "not missing"
    return "too small to matter" if visible <= UNSEEN else "undecided"


def named_effects(presence: Mapping[str, float]) -> list[str]:
    """Return the effects that are at least as probable as not; NaN stands for one that was not learned.

    If only a group of look-alikes (:func:`look_alikes`) is present, its most probable effect is named.

    Examples
    --------
    >>> named_effects({"noise": 0.9, "gain": 0.3, "offset": 0.35, "hum": 0.4})
    ['noise', 'offset']
    """
    named = {name for name, p in presence.items() if p >= NAMED}
    for group in look_alikes():
        members = {name: presence[name] for name in group if presence.get(name, 0.0) > 0}
        if members and not named & members.keys() and sum(members.values()) >= NAMED:
            named.add(max(members, key=lambda name: members[name]))
    return [name for name in presence if name in named]


def with_look_alikes(probabilities: Float, names: Sequence[str]) -> Float:
    """Return for each effect the sum of the probabilities (n_sessions, n_effects) of its group, at most 1."""
    group = {name: k for k, members in enumerate(look_alikes(), start=len(names)) for name in members}
    labels = np.array([group.get(name, k) for k, name in enumerate(names)])
    together: Float = probabilities @ (labels[:, None] == labels)
    return np.asarray(np.minimum(together, 1.0))


_FEWEST = 5  # cases from which a size is stated
_C = 100.0  # hardly shrinks a slope, and keeps that of separable cases finite


def detection_limit(strengths: Float, detected: NDArray[np.bool_], share: float) -> float:
    """Return the strength from which a share of the cases (n,) is detected, by logistic regression.

    The smallest of the strengths if it suffices; NaN if the largest does not, or for fewer than five cases.

    Examples
    --------
    >>> strengths = np.linspace(0, 1, 101)
    >>> round(detection_limit(strengths, strengths > 0.4, 0.5), 1)
    0.4
    """
    if detected.size < _FEWEST or not detected.any():
        return math.nan
    if detected.all():
        return float(strengths.min())
    centre, spread = strengths.mean(), strengths.std() + 1e-12
    line = LogisticRegression(C=_C).fit((strengths - centre)[:, None] / spread, detected)
    slope, level = float(line.coef_[0, 0]), float(line.intercept_[0])
    if slope <= 0:  # as if the size made no difference
        return float(strengths.min()) if detected.mean() >= share else math.nan
    needed = float(centre + spread * (logit(share) - level) / slope)
    return math.nan if needed > strengths.max() else max(needed, float(strengths.min()))


def strengths_of(parameter: EffectParameter, sizes: Float) -> Float:
    """Return the distance of sizes from the neutral value (or its side, if infinite), on the fit's scale."""
    neutral = _neutral_value(parameter)
    if math.isinf(neutral):
        return sizes if neutral < 0 else -sizes
    return np.asarray(np.abs(sizes - neutral))


def visible_ends(parameter: EffectParameter, strength: float) -> tuple[float, float]:
    """Return the values below and above which an effect is stronger; NaN where there are none."""
    neutral = _neutral_value(parameter)
    if math.isinf(neutral):
        scaled = (math.nan, strength) if neutral < 0 else (-strength, math.nan)
    else:
        scaled = neutral - strength, neutral + strength
    low, high = (math.exp(end) if parameter.log else float(end) for end in scaled)
    return low, high


def reach_beyond(parameter: EffectParameter, strength: float, middle: Float, spread: Float) -> Float:
    """Return the probability that normal sizes, on the fit's scale, are stronger; NaN if strength is."""
    neutral = _neutral_value(parameter)
    if math.isinf(neutral):
        away = middle if neutral < 0 else -middle
        return np.asarray(norm.sf(strength, away, spread))
    above, below = norm.sf(neutral + strength, middle, spread), norm.cdf(neutral - strength, middle, spread)
    return np.asarray(above + below)


def _neutral_value(parameter: EffectParameter) -> float:
    value = parameter.neutral or 0.0  # None: another parameter switches the effect off
    if not parameter.log:
        return value
    return math.log(value) if value > 0 else -math.inf
