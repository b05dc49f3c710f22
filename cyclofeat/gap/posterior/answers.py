"""From probabilities to answers: effects that are present, absent or unresolved, and look-alikes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cyclofeat.simulators.effects.library import look_alikes

Float = NDArray[np.float64]
EffectAnswer = Literal["present", "absent", "unresolved"]

PRESENT, ABSENT = 0.95, 0.05  # probabilities from which, and up to which, an effect counts as that
NAMED = 0.5
# An open effect counts as too small to be seen up to this probability of being there and visible.
UNSEEN = 0.02


def answer_of(probability: float) -> EffectAnswer:
    """Return the answer for an effect that is missing in the model with this probability.

    Examples
    --------
    >>> answer_of(0.97), answer_of(0.12), answer_of(0.01)
    ('present', 'unresolved', 'absent')
    """
    if probability >= PRESENT:
        return "present"
    return "absent" if probability <= ABSENT else "unresolved"


def named_effects(presence: Mapping[str, float]) -> list[str]:
    """Return the effects that are more probable than not.

    Of look-alikes (:func:`look_alikes`) of which only the group is, the most probable one is named.

    Parameters
    ----------
    presence : mapping from str to float
        Probability of each effect; NaN for one not learned.

    Examples
    --------
    >>> named_effects({"noise": 0.9, "gain": 0.3, "offset": 0.35, "hum": 0.4})
    ['noise', 'offset']
    """
    named = {name for name, p in presence.items() if p > NAMED}
    for group in look_alikes():
        members = {name: presence[name] for name in group if presence.get(name, 0.0) > 0}
        if members and not named & members.keys() and sum(members.values()) > NAMED:
            named.add(max(members, key=lambda name: members[name]))
    return [name for name in presence if name in named]


def with_look_alikes(probabilities: Float, names: Sequence[str]) -> Float:
    """Return for each effect the sum of the probabilities of its group of look-alikes, at most 1.

    Parameters
    ----------
    probabilities : ndarray, shape (n_sessions, n_effects)
    names : sequence of str
        Of the effects.
    """
    group = {name: k for k, members in enumerate(look_alikes(), start=len(names)) for name in members}
    labels = np.array([group.get(name, k) for k, name in enumerate(names)])
    together: Float = probabilities @ (labels[:, None] == labels)
    return np.asarray(np.minimum(together, 1.0))
