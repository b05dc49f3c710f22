"""Comparison of measured and simulated torque at several conditions, with one verdict."""

from __future__ import annotations

import dataclasses

from cyclofeat.gap._measured import Condition, MeasuredRig
from cyclofeat.gap._settings import GapSettings
from cyclofeat.gap.where._locate import LocatedGap, locate
from cyclofeat.gap.world import World


def locate_all(
    measured: MeasuredRig, world: World, settings: GapSettings, *, simulated: MeasuredRig | None = None
) -> tuple[LocatedGap, ...]:
    """Find where recordings differ from the model at each condition.

    Each condition is tested at ``settings.alpha`` over their number, with so many times more relabellings, so
    that the chance of a false "disagree" over all of them is at most ``alpha``.

    Parameters
    ----------
    measured : MeasuredRig
        Conditions with one recording are left out.
    world : World
        The model and what may differ anyway.
    settings : GapSettings
        ``alpha``, ``n_permutations`` and those of the simulations are used.
    simulated : MeasuredRig, optional
        Recordings of another simulator, in the place of simulated ones: of each the first output turn is
        used. With the same rate, conditions and knowledge of counts and tachometer as ``measured`` (parts of
        one :class:`MeasuredRig`); conditions that it lacks are left out. How alike recordings of one assembly
        are is not asked.

    Returns
    -------
    tuple of LocatedGap
        In the order of the conditions.

    Raises
    ------
    ValueError
        If no condition has two recordings (and two simulated ones), or ``simulated`` lacks a count.
    """
    parts = (measured,) if simulated is None else (measured, simulated)
    compared = [
        condition for condition in measured.conditions if all(len(part.at(condition)) > 1 for part in parts)
    ]
    if not compared:
        more = "" if simulated is None else ", and 2 simulated ones"
        raise ValueError(
            f"measured must hold at least 2 recordings of one condition{more}: one recording has no spread "
            f"to compare with, got {len(measured.recordings)} at {len(measured.conditions)} conditions"
        )
    shared = dataclasses.replace(
        settings,
        alpha=settings.alpha / len(compared),
        n_permutations=settings.n_permutations * len(compared),
    )
    return tuple(_located(measured, condition, world, shared, simulated) for condition in compared)


def _located(
    measured: MeasuredRig,
    condition: Condition,
    world: World,
    settings: GapSettings,
    simulated: MeasuredRig | None,
) -> LocatedGap:
    """Compare the recordings of one condition."""
    comparison = measured.comparison(condition, world, settings)
    turns = measured.turns(comparison)
    bank = None
    if simulated is not None:
        comparison = comparison.replace(one_assembly=False)
        bank = simulated.bank(comparison)
        missing = set() if turns.counts is None else set(turns.counts.tolist()) - set(bank.counts.tolist())
        if missing:
            raise ValueError(
                f"simulated must hold each count of the measured recordings at {condition.text}, got none "
                f"with {min(missing)} worn lobes"
            )
    return locate(
        comparison,
        turns,
        alpha=settings.alpha,
        n_permutations=settings.n_permutations,
        bank=bank,
    )
