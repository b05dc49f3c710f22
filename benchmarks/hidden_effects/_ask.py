"""Answers of the toolkit on sets, in the format of the results."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from benchmarks.hidden_effects._answers import FORMAT
from benchmarks.hidden_effects._folders import read_set
from benchmarks.hidden_effects._machine import SAMPLING_RATE
from benchmarks.hidden_effects._sets import definitions
from benchmarks.hidden_effects._visible import effects_of
from cyclofeat.gap import EffectPosterior, GapSettings, find_gap
from cyclofeat.gap.measured import MeasuredRig
from cyclofeat.gap.proof.prove import prove_all
from cyclofeat.gap.simulations import remember
from cyclofeat.gap.world.world import Session
from cyclofeat.simulators import Rig

_CODE = ("gap/world", "gap/summaries")
_AT_A_TIME = 20


def session_of(name: str, folder: Path) -> Session:
    """Summaries of the recordings of a set that are to be fitted."""
    recordings, _ = read_set(name, folder)
    return MeasuredRig.of(recordings, Rig(), SAMPLING_RATE).session()


def sessions_of(names: Iterable[str], folder: Path, jobs: int = 1) -> dict[str, Session]:
    """Sessions of the sets that the folder has; they are stored beside it while the code stays the same."""
    kept = folder.with_name(f"{folder.name}_sessions")
    there = [name for name in names if (folder / name).exists()]

    def some(part: Sequence[str]) -> list[Session]:
        return [
            remember(kept, lambda name=name: session_of(name, folder), "sessions", name, code=_CODE)
            for name in part
        ]

    parts = [there[first : first + _AT_A_TIME] for first in range(0, len(there), _AT_A_TIME)]
    made = joblib.Parallel(n_jobs=jobs)(joblib.delayed(some)(part) for part in parts)
    return dict(zip(there, itertools.chain.from_iterable(made), strict=True))


def shown(session: Session, n: int | None = None, *, counts: bool = True) -> Session:
    """A session of some of the recordings, evenly chosen, or without their counts."""
    size = len(session.values)
    rows = np.arange(size) if n is None else np.arange(n) * size // n
    known = counts and session.counts is not None
    return Session(session.values[rows], session.conditions[rows], session.counts[rows] if known else None)


def names_of(posterior: EffectPosterior, sessions: Sequence[Session]) -> list[dict[str, Any]]:
    """Results that hold what a posterior says, without verdict, confirmation and proof."""
    return [
        result_of(guess.presence, guess.visible, {key: ends[[0, 2, 4]] for key, ends in guess.sizes.items()})
        for guess in posterior.guess(sessions)
    ]


def result_of(
    presence: Mapping[str, float], visible: Mapping[str, float], quantiles: Mapping[str, Any]
) -> dict[str, Any]:
    """Result of each effect's probability, and of low, middle and high of each size, without what is NaN."""
    sizes: dict[str, dict[str, dict[str, float]]] = {}
    for key, ends in quantiles.items():
        name, _, parameter = key.partition(".")
        if np.isfinite(ends).all():
            low, middle, high = (float(end) for end in ends)
            sizes.setdefault(name, {})[parameter] = {"value": middle, "low": low, "high": high}
    effects = [
        {"id": name, "probability": p, "visible": visible[name], "sizes": sizes.get(name, {})}
        for name, p in presence.items()
        if np.isfinite(p)
    ]
    return {"format": FORMAT, "effects": effects}


def whole_answer(
    name: str, folder: Path, posterior: EffectPosterior, settings: GapSettings
) -> dict[str, Any]:
    """Result of the whole workflow on a set; its proof compares the oracle too.

    The oracle, the true rig, is left out where the library lacks an effect of the set. Recordings that are
    refused are an answer that names nothing.
    """
    truth = definitions()[name]
    fit, held_out = read_set(name, folder)
    try:
        result = find_gap(fit, held_out or None, posterior=posterior, settings=settings)
    except ValueError as error:
        return {"format": FORMAT, "effects": [], "refused": str(error)}
    plain = result.to_dict()
    if result.proof and truth.kind != "outside":
        true_rig = Rig().with_added(*effects_of(truth).values())
        world = posterior.world
        fitted = MeasuredRig.of(fit, world.rig, world.sampling_rate, quantity=world.quantity)
        held = MeasuredRig.of(
            held_out, world.rig, world.sampling_rate, quantity=world.quantity, beside=fitted
        )
        proofs = prove_all(fitted, held, result.rig, world, settings, others={"oracle": true_rig})
        plain["proof"] = [
            dataclasses.asdict(proof.condition) | {"closed": proof.to_dict()} for proof in proofs
        ]
    return plain
