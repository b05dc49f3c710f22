"""The gap in torque-deflection loops: missing clearance, friction and compliance of a drive's model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat.gap.engine.problem import Effect, Parameter, Rig, Session
from cyclofeat.gap.engine.search import Explanation, explain
from cyclofeat.simulators import CycloidalGearbox, torque_deflection

Float = NDArray[np.float64]

# Clearances in m for which the curve of the contacts is simulated; linear interpolation between them.
_CLEARANCES = (0.0, 2.5e-5, 5e-5, 1e-4, 2e-4, 4e-4)
LARGEST_TORQUE = 115.0
"""Torque in Nm up to which contacts are simulated; beyond it they may slip over the pins."""
_HERTZ = 2 / 3  # exponent of the deflection over the torque where contacts begin to carry
_HERTZ_BELOW = 0.5  # Nm below which that law replaces the simulation
_GRID = 400
_N_POINTS = 80  # of a loop
_STAGES = 8  # friction elements that share the Coulomb friction


class Loop(NamedTuple):
    """Torque of a loop in Nm at evenly spaced points, and the rms of its deflection in rad."""

    torque: Float
    rms: float


class HeldDrive:
    r"""Torque-deflection loops of a drive with held output: contacts, play, friction, compliance in series.

    .. math:: x = \frac{1}{8} \sum_{i=1}^{8} \left( x_c(s E_i; c) + E_i / k \right),

    with the contacts' deflection x_c for the clearance c (:func:`contact_deflection`), s the softness of
    their material, 1/k the torsional compliance of housing and shafts, and E_i the torque behind friction
    (:func:`elastic_torque`). Friction does not hold all of the drive at once: its Coulomb part is spread
    evenly over T_c (1 - ``spread``) to T_c (1 + ``spread``) among eight equal stages in series (a sum of
    play operators, after Prandtl and Ishlinskii), which rounds the loop's corners. Everything is slow: no
    inertia, no creep.

    The cells are deflections over the loop's rms deflection; differences matter from `floor`.
    """

    effects: Mapping[str, Effect] = {
        "clearance": Effect({"clearance": Parameter("m", 1e-6, 4e-4)}),
        "friction": Effect(
            {
                "coulomb": Parameter("Nm", 0.01, 10.0),
                "spread": Parameter("", 0.01, 1.0),
                "load_share": Parameter("", 1e-3, 0.9),
            }
        ),
        "torsional_compliance": Effect({"compliance": Parameter("rad/Nm", 1e-5, 1 / 30)}),
        "contact_softness": Effect({"factor": Parameter("", 0.05, 2.8)}),
    }
    blocks = np.zeros(_N_POINTS, dtype=np.int64)

    def __init__(self, gearbox: CycloidalGearbox, floor: float) -> None:
        self.gearbox, self.floors = gearbox, np.full(_N_POINTS, floor)

    def simulate(self, conditions: Sequence[Loop], rigs: Sequence[Rig]) -> Float:
        """Return centred deflections of loops over the measured rms, (n_rigs, n_loops, n_points)."""

        def sizes(effect: str, key: str, neutral: float = 0.0) -> Float:
            return np.array([rig.get(effect, {}).get(key, neutral) for rig in rigs])[:, None, None]

        stage = (2 * np.arange(_STAGES) + 1) / _STAGES - 1
        coulomb = sizes("friction", "coulomb") * (1 + sizes("friction", "spread") * stage)
        torque = np.array([loop.torque for loop in conditions])[:, None]
        elastic = elastic_torque(torque, coulomb, sizes("friction", "load_share"))
        softness = sizes("contact_softness", "factor", 1.0)
        x = contact_deflection(self.gearbox, elastic, sizes("clearance", "clearance"), softness)
        x += elastic * sizes("torsional_compliance", "compliance")[..., None]
        return centre_loop(x.mean(axis=2) / np.array([loop.rms for loop in conditions])[:, None])


def centre_loop(deflection: Float) -> Float:
    """Return deflections (..., n) less the middle between their extremes, as their zero is arbitrary."""
    extremes = deflection.max(axis=-1, keepdims=True) + deflection.min(axis=-1, keepdims=True)
    return np.asarray(deflection - 0.5 * extremes)


def loop_session(loops: Sequence[Any], gearbox: CycloidalGearbox | None = None) -> Session:
    """Return loops at points evenly spaced along the path of their torque (:func:`find_loop_gap`).

    Deflections matter from the largest by which a loop fails to close, at least 2 %, of the rms deflection.
    """
    conditions, cells, openings = [], [], []
    for loop in loops:
        t, x = (np.asarray(values, dtype=np.float64) for values in (loop.torque, loop.deflection))
        if t.ndim != 1 or t.shape != x.shape or t.size < 8 or not np.isfinite([t, x]).all():
            raise ValueError(
                "loops must have torque and deflection of at least 8 finite numbers each, got shapes "
                f"{t.shape} and {x.shape}"
            )
        if not -LARGEST_TORQUE <= t.min() < 0 < t.max() <= LARGEST_TORQUE:
            raise ValueError(
                f"torque of a loop must swing through zero and not exceed {LARGEST_TORQUE:g} Nm, at which "
                f"the contacts' curve ends, got {t.min():.4g} to {t.max():.4g} Nm"
            )
        path = np.r_[0.0, np.cumsum(np.abs(np.diff(t)))]
        # Of samples at equal torque the last one counts.
        kept = np.r_[np.diff(path) > 0, True]
        at = np.linspace(0, path[-1], _N_POINTS)
        centred = centre_loop(np.interp(at, path[kept], x[kept]))
        rms = float(np.sqrt(np.mean(centred**2)))
        conditions.append(Loop(np.interp(at, path[kept], t[kept]), rms))
        cells.append(centred / rms)
        openings.append(float(np.ptp(cells[-1][[0, -1]])))
    if not cells:
        raise ValueError("loops must hold at least one loop, got none")
    gearbox = CycloidalGearbox.printed_14_pin() if gearbox is None else gearbox
    problem = HeldDrive(gearbox, max(0.02, *openings))
    return Session(problem, conditions, np.array(cells))


def find_loop_gap(loops: Sequence[Any], gearbox: CycloidalGearbox | None = None) -> Explanation:
    """Find the effects that a drive's model needs to predict torque-deflection loops left out of the fit.

    Effects are missing clearance, friction, torsional compliance and softness of the contacts
    (:class:`~cyclofeat.gap.cases.held_drive.HeldDrive`).

    Parameters
    ----------
    loops : sequence
        At least 3, each with ``torque`` and ``deflection``, shape (n,), in Nm and rad: one cycle, from and to
        about zero torque, as :func:`cyclofeat.datasets.load_jelmerv_cycloidal` gives them. Their drives have
        the same parameters, and their peaks differ.
    gearbox : CycloidalGearbox, optional
        Geometry and contacts. Default: ``CycloidalGearbox.printed_14_pin()``.

    Returns
    -------
    Explanation
        Probabilities, sizes with intervals, and look-alikes that the loops cannot tell apart.

    Raises
    ------
    ValueError
        If there are fewer than 3 loops, a loop is no cycle, or its torque is too large.

    Examples
    --------
    >>> from cyclofeat.datasets import load_jelmerv_cycloidal
    >>> loops = [x for x in load_jelmerv_cycloidal().loops if x.state == "initial"]
    >>> find_loop_gap(loops).state("friction")  # doctest: +SKIP
    'missing'
    """
    return explain(loop_session(loops, gearbox))


def elastic_torque(torque: ArrayLike, coulomb: ArrayLike, load_share: ArrayLike) -> Float:
    r"""Return the torque of the elastic parts behind friction, over one closed cycle: (..., n).

    .. math:: |T - E| \le T_c + \mu |E|,

    and E changes only where it has to: a play operator whose half width grows with the load. Rising, E
    follows T - T_c - mu |E|, falling T + T_c + mu |E|. T has the shape (..., n), T_c in Nm and mu, from 0 to
    below 1, (...).

    Examples
    --------
    >>> elastic_torque([0.0, 5.0, 0.0, -5.0], 1.0, 0.0)
    array([-1.,  4.,  1., -4.])
    """
    t = np.asarray(torque, dtype=np.float64)
    friction, share = (np.asarray(x, dtype=np.float64)[..., np.newaxis] for x in (coulomb, load_share))
    # The torque E of a drive that slips: E + T_c + mu |E| = T rising, and the mirror image falling.
    low, high = (
        sign * (side - friction) / np.where(side > friction, 1 + share, 1 - share)
        for sign, side in ((1, t), (-1, -t))
    )
    elastic, state = np.empty_like(low), low[..., 0]
    for k in (*range(t.shape[-1]), *range(t.shape[-1])):  # the second cycle is closed
        state = np.minimum(np.maximum(state, low[..., k]), high[..., k])
        elastic[..., k] = state
    return elastic


def contact_deflection(
    gearbox: CycloidalGearbox, torque: ArrayLike, clearance: ArrayLike, softness: ArrayLike = 1.0
) -> Float:
    """Deflection in rad of the contacts of a gearbox with held output under a slow torque: (..., n).

    It is an odd function of the torque that the contacts carry, in Nm at the output (..., n): half the play
    where the torque leaves zero, then what the contacts give way. The gearbox has ``clearance`` (...) in m of
    pins and output rollers, and no friction. ``softness`` (...) divides the stiffness of all contacts: the
    deflection at T is that of the gearbox itself at ``softness`` T, up to 115 Nm.

    It is interpolated between :func:`cyclofeat.simulators.torque_deflection` at six clearances (falling
    torque, input at its angle 0, as the loops do not state it); below 0.5 Nm Hertz' law a + b T^(2/3) holds.
    """
    t = np.asarray(torque, dtype=np.float64)
    gap, scale = (np.asarray(x, dtype=np.float64)[..., np.newaxis] for x in (clearance, softness))
    size = np.minimum(np.abs(t) * scale, LARGEST_TORQUE)
    curves = _contact_curves(gearbox)
    steps = np.diff(_CLEARANCES)
    row = np.clip(np.searchsorted(_CLEARANCES, gap, side="right") - 1, 0, steps.size - 1)
    share = (gap - np.asarray(_CLEARANCES)[row]) / steps[row]
    place = np.sqrt(size / LARGEST_TORQUE) * (_GRID - 1)
    at = np.minimum(place.astype(np.intp), _GRID - 2)
    rest = place - at
    below = (1 - rest) * curves[row, at] + rest * curves[row, at + 1]
    above = (1 - rest) * curves[row + 1, at] + rest * curves[row + 1, at + 1]
    return np.asarray(np.sign(t) * ((1 - share) * below + share * above))


@lru_cache(maxsize=8)
def _contact_curves(gearbox: CycloidalGearbox) -> Float:
    """Deflections in rad, (n_clearances, n), at torques evenly spaced in their square root."""
    # Finer near zero, where the curve is steep.
    grid = LARGEST_TORQUE * np.linspace(0, 1, _GRID) ** 2
    curves = []
    for clearance in _CLEARANCES:
        # Without friction and compliance.
        plain = gearbox.replace(
            clearance=clearance, pin_clearance=clearance, brake_inertia=0.0, meter_stiffness=0.0,
            meter_damping=0.0, sleeve_friction=0.0, sleeve_static_friction=0.0, sleeve_viscous_friction=0.0,
            journal_friction=0.0, input_bearing_torque=0.0, input_bearing_viscosity=0.0,
            output_bearing_torque=0.0, output_bearing_viscosity=0.0,
        )  # fmt: skip
        loop = torque_deflection(plain, peak_torque=1.05 * LARGEST_TORQUE, n_points=8000, n_cycles=1)
        n = loop.torque.size
        falling = slice(n // 4 + 1, n // 2)
        held, deflection = loop.held_torque[falling][::-1], loop.deflection[falling][::-1]
        order = np.argsort(held, kind="stable")
        held, deflection = held[order], deflection[order]
        near = (held > _HERTZ_BELOW) & (held < 8 * _HERTZ_BELOW)
        slope, start = np.polyfit(held[near] ** _HERTZ, deflection[near], 1)
        low = max(start, 0.0) + slope * grid**_HERTZ
        curve = np.where(grid < _HERTZ_BELOW, low, np.interp(grid, held, deflection))
        curves.append(np.maximum.accumulate(curve))
    return np.array(curves)
