"""Effects that recordings could reveal, with their least sizes, and the posterior's right answers."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base import displays
from cyclofeat._base.checks import check_type, seed_number, whole
from cyclofeat._base.displays import Card, WithCard, data_frame
from cyclofeat.gap.comparison import Condition
from cyclofeat.gap.confirm.next_measurement import rank_measurements
from cyclofeat.gap.confirm.sessions import simulate_prior
from cyclofeat.gap.measured import MeasuredRig
from cyclofeat.gap.posterior.answers import (
    NAMED,
    detection_limit,
    strengths_of,
    visible_ends,
    with_look_alikes,
)
from cyclofeat.gap.posterior.effect_posterior import EffectPosterior, load_posterior
from cyclofeat.gap.result import EffectRows, NextMeasurement, replace_nonfinite
from cyclofeat.gap.world.world import Rigs, Session, World
from cyclofeat.recordings import Recording
from cyclofeat.simulators import Effect

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]
Flags = NDArray[np.bool_]
ProgressCall = Callable[[int, int], object]

_FORMAT = "cyclofeat gap check 1"
_HALF, _MOST = 0.5, 0.9
_CONFUSED = 0.1  # rise of another effect's probability
_FEWEST, _MOST_NAMES = 3, 3  # rigs in which an effect is missed, and names that it is confused with


@dataclass(frozen=True)
class CheckedEffect:
    """Detectability of one effect in recordings."""

    effect: str
    n: int  # simulated rigs that have it
    recall: float  # share of them in which it is found: its probability is above one half
    parameter: str  # its main parameter
    unit: str
    # Values of this parameter below and above which the effect is found in half of the cases, and in 9 of 10.
    # NaN on a side on which it grows no stronger, and on both if no simulated rig has it strong enough or
    # fewer than five have it.
    half_below: float
    half_above: float
    most_below: float
    most_above: float
    confused_with: tuple[str, ...] = ()  # up to three, more probable where it is missed


@dataclass(frozen=True)
class PosteriorScore:
    """Shares of right answers of a posterior, which names effects with a probability above one half."""

    n_rigs: int
    precision: float
    recall: float
    sets_right: float  # rigs whose effects are named exactly
    sets_right_with_ties: float  # the same, if one of a group of look-alikes may be named for another

    @classmethod
    def of(cls, probabilities: Float, present: Flags, names: Sequence[str]) -> PosteriorScore:
        """Score the probabilities of effects in rigs (n_rigs, n_effects); one that is NaN names nothing."""
        named = probabilities > NAMED
        groups, true = (with_look_alikes(flags.astype(float), names) > 0 for flags in (named, present))
        shares = (float(np.sum(named & present) / n) if n else math.nan for n in (named.sum(), present.sum()))
        sets = (float(np.all(a == b, axis=1).mean()) for a, b in ((named, present), (groups, true)))
        return cls(len(named), *shares, *sets)


@dataclass(frozen=True, kw_only=True)
class GapCheck(EffectRows[CheckedEffect], WithCard):
    """Result of :func:`check_recordings`: detectable effects, and right answers of the posterior.

    Attributes
    ----------
    conditions : tuple of Condition
        The condition of each recording.
    effects : tuple of CheckedEffect
        All that the posterior has learned, in its order.
    score : PosteriorScore
        Shares of right answers on the simulated rigs.
    wrong : dict from str to int
        How often an effect was named that was absent, the most frequent first; without those that never were.
    next_measurements : tuple of NextMeasurement
        Measurements that would help to find what is missed, the most useful first.
    seconds : float
        Computing time.
    """

    conditions: tuple[Condition, ...] = field(repr=False)
    effects: tuple[CheckedEffect, ...] = field(repr=False)
    score: PosteriorScore
    wrong: dict[str, int]
    next_measurements: tuple[NextMeasurement, ...]
    seconds: float = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values that JSON can hold, as ``cyclofeat gap --check --json`` prints them.

        Returns
        -------
        dict from str to object
        """
        score = asdict(self.score)
        plain = {
            "format": _FORMAT,
            "recordings": len(self.conditions),
            "conditions": [asdict(row) for row in dict.fromkeys(self.conditions)],
            "rigs": score.pop("n_rigs"),
            **score,
            "wrong": self.wrong,
            "effects": [asdict(row) for row in self.effects],
            "next_measurements": [asdict(row) for row in self.next_measurements],
            "seconds": round(self.seconds, 1),
        }
        return dict(replace_nonfinite(plain))

    def to_frame(self) -> pd.DataFrame:
        """Return the effects as a data frame, one row each; needs pandas.

        Returns
        -------
        pandas.DataFrame
        """
        return data_frame([asdict(row) for row in self.effects])

    def _card(self) -> Card:
        asked = sorted((row for row in self.effects if row.n), key=lambda row: -row.recall)
        rarely = [row.effect for row in asked if row.recall < _HALF]
        rows = {
            "recordings": f"{len(self.conditions)} at "
            + "; ".join(dict.fromkeys(row.text for row in self.conditions)),
            "simulated rigs": self.score.n_rigs,
            "sets named exactly": f"{self.score.sets_right:.0%}",
            "the same but for look-alikes": f"{self.score.sets_right_with_ties:.0%}",
            "names that are right": f"{self.score.precision:.0%}",
            "found in less than half": ", ".join(rarely),
            "would help": "; ".join(row.what for row in self.next_measurements),
        }
        names = [row.effect for row in asked]
        text = "Share of the rigs with an effect in which it is found, effect by effect"
        recalls = [row.recall for row in asked]
        return Card(
            f"Check: {self.score.recall:.0%} of the effects found", rows,
            lambda: [displays.draw_columns(recalls, names, text, marked=names)], code="check.to_frame()",
        )  # fmt: skip


def check_recordings(
    recordings: Iterable[Recording] | Iterable[Condition],
    *,
    posterior: EffectPosterior | None = None,
    n_rigs: int = 240,
    random_state: int | None = None,
    n_jobs: int = 1,
    progress: ProgressCall | None = None,
) -> GapCheck:
    """Find out what recordings can tell, before they are made or before their gap is looked for.

    Rigs with random sets of effects of random sizes are simulated at the conditions of the recordings, and
    the posterior is asked what each has. The torque of the recordings is not used.

    Parameters
    ----------
    recordings : iterable of Recording or of Condition
        Recordings that were made, or the condition of each one that is planned: those are taken to be of
        known counts of worn lobes, all that the posterior knows in turn, without a tachometer.
    posterior : EffectPosterior, optional
        Default: that of paper B's gearbox (:func:`cyclofeat.gap.load_posterior`).
    n_rigs : int, default=240
        With 32 effects, some 20 rigs have each of them.
    random_state : int, optional
        Default: drawn at random.
    n_jobs : int, default=1
        Number of worker processes.
    progress : callable, optional
        Called with the number of simulated rigs and their total.

    Returns
    -------
    GapCheck

    Raises
    ------
    ValueError, TypeError
        If recordings and posterior do not fit together.

    Notes
    -----
    Sizes are logistic regressions of "found" on the main parameter; all else varies from rig to rig.

    Examples
    --------
    >>> planned = [Condition(500, 22)] * 6 + [Condition(500, 11)] * 6
    >>> check = check_recordings(planned, n_jobs=2)  # doctest: +SKIP
    >>> print(check.effect("gain"), check.score.sets_right)  # doctest: +SKIP
    """
    began = time.monotonic()
    posterior = posterior or load_posterior()
    whole("n_rigs", n_rigs, 1)
    state = seed_number(random_state)
    world = posterior.world
    template = _session_template(tuple(recordings), world)
    posterior.predict_proba([template])  # conditions that it has not learned fail at once
    rigs = simulate_prior(world, template, n_rigs, random_state=state, n_jobs=n_jobs, progress=progress)
    counts, tachometer = template.counts is not None, template.speeds_rpm is not None
    p = posterior.predict_proba(
        [rigs.session(k, counts=counts, tachometer=tachometer) for k in range(len(rigs))]
    )
    wrong = np.sum((p > NAMED) & ~rigs.present, axis=0)
    counted = sorted(zip(wrong.tolist(), world.names, strict=True), key=lambda one: -one[0])
    effects = tuple(
        _check_effect(k, p, rigs, world) for k in np.flatnonzero(np.isfinite(p).all(axis=0)).tolist()
    )
    return GapCheck(
        conditions=tuple(Condition(at[0], at[1], int(at[2])) for at in template.conditions.tolist()),
        effects=effects,
        score=PosteriorScore.of(p, rigs.present, rigs.names),
        wrong={name: n for n, name in counted if n},
        next_measurements=rank_measurements(
            {row.effect: 1 - row.recall for row in effects if row.n}, template, world
        ),
        seconds=time.monotonic() - began,
    )


def _session_template(recordings: tuple[Any, ...], world: World) -> Session:
    """Return a session with the conditions of recordings, and what is known of them."""
    if not recordings or isinstance(recordings[0], Recording):
        rig = MeasuredRig.of(recordings, world.rig, world.sampling_rate, quantity=world.quantity)
        return rig.session()
    for condition in recordings:
        check_type("recordings", condition, Condition)
    n = len(recordings)
    return Session(
        np.zeros((n, len(world.cells))),
        np.array([dataclasses.astuple(condition) for condition in recordings], dtype=float),
        counts=np.resize(np.array(world.defect_counts), n),
    )


def _check_effect(column: int, p: Float, rigs: Rigs, world: World) -> CheckedEffect:
    """Return how well an effect is found, given the probabilities of all in each rig."""
    effect: Effect = (world.effects or ())[column]
    having, found = rigs.present[:, column], p[:, column] > NAMED
    name = effect.main_parameter
    parameter = effect.parameters[name]
    sizes = rigs.sizes[having, world.size_names.index(f"{effect.effect_id}.{name}")]
    strengths = strengths_of(parameter, sizes)
    half, most = (
        visible_ends(parameter, detection_limit(strengths, found[having], share)) for share in (_HALF, _MOST)
    )
    missed, without = having & ~found, ~having
    rises: dict[str, float] = {}
    for k, other in enumerate(rigs.names if missed.sum() >= _FEWEST else ()):
        absent = ~rigs.present[:, k]
        if np.any(missed & absent) and np.any(without & absent):
            rises[other] = float(p[missed & absent, k].mean() - p[without & absent, k].mean())
    # Absent effects whose probability is higher where the effect is missed than without it.
    confused = sorted((other for other in rises if rises[other] > _CONFUSED), key=lambda other: -rises[other])
    return CheckedEffect(
        effect.effect_id, int(having.sum()), float(np.mean(found[having])) if having.any() else np.nan,
        name, parameter.unit, *half, *most, tuple(confused[:_MOST_NAMES]),
    )  # fmt: skip
