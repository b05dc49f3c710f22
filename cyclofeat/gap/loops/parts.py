"""Parts of torque-deflection loops: shape, friction as a play operator, and curve of the contacts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import trapezoid

from cyclofeat.simulators import CycloidalGearbox, torque_deflection

Float = NDArray[np.float64]

# Clearances in m for which the curve of the contacts is simulated; linear interpolation between them.
_CLEARANCES = (0.0, 2.5e-5, 5e-5, 1e-4, 2e-4, 4e-4)
# Torque in Nm up to which contacts are simulated; beyond it they may slip over the pins.
LARGEST_TORQUE = 115.0
_HERTZ = 2 / 3  # exponent of the deflection over the torque where contacts begin to carry
_HERTZ_BELOW = 0.5  # Nm below which that law replaces the simulation
_GRID = 400


@dataclass(frozen=True)
class LoopShape:
    """Numbers that a test bench states of a loop.

    Enclosed area in J, width in rad between the two crossings of zero torque, and slope in Nm/rad of the
    loading branches between half and the whole of the peak torque.
    """

    area: float
    lost_motion: float
    stiffness: float


def loop_shape(torque: ArrayLike, deflection: ArrayLike) -> LoopShape:
    """Area, lost motion and stiffness of a loop.

    One cycle in Nm and rad, (n,), in its order in time, both counted in the same sense. Lost motion or
    stiffness that the loop does not show is NaN.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.r_[np.linspace(0, 10, 50), np.linspace(10, -10, 100), np.linspace(-10, 0, 50)]
    >>> round(loop_shape(t, t / 200).stiffness)
    200
    """
    t, x = checked_loop(torque, deflection)
    closed_t, closed_x = np.append(t, t[0]), np.append(x, x[0])
    area = abs(float(trapezoid(closed_t, closed_x)))
    rising, falling = loop_branches(t)
    crossings, slopes = [], []
    for branch, side in ((rising, 1.0), (falling, -1.0)):
        order = np.argsort(t[branch], kind="stable")
        crossings.append(float(np.interp(0.0, t[branch][order], x[branch][order])))
        loading = branch[(side * t[branch] > 0.5 * np.abs(t).max())]
        if loading.size >= 3 and np.ptp(x[loading]) > 0:
            slopes.append(np.polyfit(x[loading], t[loading], 1)[0])
    stiffness = float(np.mean(slopes)) if slopes else math.nan
    return LoopShape(area, abs(crossings[0] - crossings[1]), stiffness)


def relative_error(measured: ArrayLike, predicted: ArrayLike) -> Float:
    """Rms of the difference of two deflections over the rms of the first, each centred between its extremes.

    They are centred because the zero of a deflection is arbitrary. The error of a prediction of 0 is 1.
    ``measured`` has the shape (n,), ``predicted`` (..., n).
    """
    first, second = centre_loop(np.asarray(measured)), centre_loop(np.asarray(predicted))
    return np.asarray(np.sqrt(np.mean((first - second) ** 2, axis=-1) / np.mean(first**2)))


def elastic_torque(torque: ArrayLike, coulomb: ArrayLike, load_share: ArrayLike) -> Float:
    r"""Return the torque of the elastic parts behind friction, over one closed cycle: (..., n).

    .. math:: |T - E| \le T_c + \mu |E|,

    and E changes only where it has to: a play operator whose half width grows with the load (Coulomb friction
    T_c of the drive and a share mu of what it carries, as in a mesh of constant efficiency). Rising, E
    follows T - T_c - mu |E|, falling T + T_c + mu |E|, and it stands still in between. T has shape (n,), T_c
    in Nm and mu, from 0 to below 1, have shape (...).

    Examples
    --------
    >>> elastic_torque([0.0, 5.0, 0.0, -5.0], 1.0, 0.0)
    array([-1.,  4.,  1., -4.])
    """
    t = np.asarray(torque, dtype=np.float64)
    # At the largest torque of a closed cycle the drive has slipped farthest.
    top = int(np.argmax(t))
    rolled = np.roll(t, -top)
    friction, share = (np.asarray(x, dtype=np.float64)[..., np.newaxis] for x in (coulomb, load_share))
    low, high = _slipping_torque(rolled, friction, share), -_slipping_torque(-rolled, friction, share)
    elastic = np.empty_like(low)
    state = low[..., 0]
    for k in range(t.size):
        state = np.minimum(np.maximum(state, low[..., k]), high[..., k])
        elastic[..., k] = state
    return np.roll(elastic, top, axis=-1)


def _slipping_torque(torque: Float, coulomb: Float, load_share: Float) -> Float:
    """Solve E + T_c + mu |E| = T for E, the elastic torque of a drive that slips while the torque rises."""
    left = torque - coulomb
    return left / np.where(left > 0, 1 + load_share, 1 - load_share)


def contact_deflection(
    gearbox: CycloidalGearbox, torque: ArrayLike, clearance: ArrayLike, factor: ArrayLike = 1.0
) -> Float:
    """Deflection in rad of the contacts of a gearbox with held output under a slow torque: (..., n).

    It is an odd function of the torque that the contacts carry, in Nm at the output (..., n): half the play
    where the torque leaves zero, then what the contacts give way. The gearbox has ``clearance`` (...) in m of
    pins and output rollers, and no friction. ``factor`` (...) is on the stiffness of all contacts: the
    deflection at T is that of the gearbox itself at T / factor.

    Notes
    -----
    From :func:`cyclofeat.simulators.torque_deflection` (the branch on which the torque falls),
    for six clearances, straight between them; below 0.5 Nm Hertz' law a + b T^(2/3) through the values above.
    The input begins at its angle 0: play and stiffness depend on the angle, which is not known of the loops.
    """
    t = np.asarray(torque, dtype=np.float64)
    gap, scale = (np.asarray(x, dtype=np.float64)[..., np.newaxis] for x in (clearance, factor))
    size = np.abs(t) / scale
    if size.size and size.max() > LARGEST_TORQUE:
        raise ValueError(
            f"torque over factor must not exceed {LARGEST_TORQUE:g} Nm, at which the contacts' curve ends, "
            f"got {size.max():.4g}"
        )
    if not ((gap >= 0) & (gap <= _CLEARANCES[-1])).all():
        raise ValueError(f"clearance must lie between 0 and {_CLEARANCES[-1]:g} m, got {clearance!r}")
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
        plain = without_effects(gearbox).replace(clearance=clearance, pin_clearance=clearance)
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


def without_effects(gearbox: CycloidalGearbox) -> CycloidalGearbox:
    """Return the drive without clearance, friction and compliance."""
    return gearbox.replace(
        clearance=0.0, pin_clearance=0.0, brake_inertia=0.0, meter_stiffness=0.0, meter_damping=0.0,
        sleeve_friction=0.0, sleeve_static_friction=0.0, sleeve_viscous_friction=0.0, journal_friction=0.0,
        input_bearing_torque=0.0, input_bearing_viscosity=0.0, output_bearing_torque=0.0,
        output_bearing_viscosity=0.0,
    )  # fmt: skip


def checked_loop(torque: ArrayLike, deflection: ArrayLike) -> tuple[Float, Float]:
    t, x = np.asarray(torque, dtype=np.float64), np.asarray(deflection, dtype=np.float64)
    if t.ndim != 1 or t.shape != x.shape or t.size < 8:
        raise ValueError(
            f"torque and deflection must be two sequences of at least 8 numbers, got shapes {t.shape} and "
            f"{x.shape}"
        )
    if not np.isfinite([t, x]).all():
        raise ValueError("torque and deflection must be finite, got NaN or infinity")
    if not t.min() < 0 < t.max():
        raise ValueError(f"torque must swing through zero, got {t.min():g} to {t.max():g} Nm")
    return t, x


def loop_branches(torque: Float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the samples of rising and of falling torque, from extreme to extreme, in order of time."""
    top, bottom = int(np.argmax(torque)), int(np.argmin(torque))
    index = np.arange(torque.size)
    first, last = min(top, bottom), max(top, bottom)
    between = index[(index >= first) & (index <= last)]
    around = np.r_[index[index > last], index[index < first]]
    return (around, between) if top < bottom else (between, around)


def evenly_spaced(torque: Float, deflection: Float, n: int) -> tuple[Float, Float]:
    """Return a loop at points evenly spaced along the path of its torque."""
    path = np.r_[0.0, np.cumsum(np.abs(np.diff(torque)))]
    # Of samples at equal torque the last one counts.
    keep = np.r_[np.diff(path) > 0, True]
    at = np.linspace(0, path[-1], n)
    return np.interp(at, path[keep], torque[keep]), np.interp(at, path[keep], deflection[keep])


def centre_loop(deflection: Float) -> Float:
    extremes = deflection.max(axis=-1, keepdims=True) + deflection.min(axis=-1, keepdims=True)
    return np.asarray(deflection - 0.5 * extremes)
