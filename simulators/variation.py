"""Variation of a rig from assembly to assembly, so that training data hold machines of any quality."""

from __future__ import annotations

from typing import Any

import numpy as np

from cyclofeat.simulators.effects import Drift, Effect, Gain, Hum, Noise, Offset, TorqueMeterLowPass
from cyclofeat.simulators.effects._parameter import from_plain, is_distribution, to_plain
from cyclofeat.simulators.rig import Rig
from cyclofeat.simulators.sampling import log_uniform

# Assumptions: errors and drift as multiples of what the rig states, and noise, log-uniform.
_ERRORS, _NOISE = (0.0, 1.5), (0.1, 1.5)
# Largest hum, drift and offset of a torque meter as shares of the load, its gain, its lowest cut-off in Hz.
_HUM, _DRIFT, _OFFSET, _GAIN, _CUTOFF_HZ = 0.014, 0.14, 0.09, 0.05, 300.0
_BELOW_NYQUIST = 0.9
# Probability of each of these five.
_HARMLESS = 1 / 8


def vary_errors(rig: Rig, random: np.random.Generator, sampling_rate: float) -> Rig:
    """Return the rig of one assembly with as much of its errors as a better or a poorer bench has.

    Errors of the geometry, all by one factor, and drift are uniform from none to 1.5 times what the rig
    states; noise is log-uniform from a tenth to 1.5 times. With a probability of 1/8 each, the assembly has
    mains hum, a meter that drifts, one with an offset, one with another gain, or one with a low-pass. None of
    it spoils a count (all *assumptions*).

    Parameters
    ----------
    rig : Rig
    random : numpy.random.Generator
    sampling_rate : float
        In Hz, which limits the cut-off of the low-pass.

    Returns
    -------
    Rig

    Examples
    --------
    >>> vary_errors(Rig.r1(), np.random.default_rng(0), 25_600).effects[0]
    PinErrors(rms=9.554425309821816e-06)
    """
    geometry, drift = random.uniform(*_ERRORS, 2).tolist()
    noise = log_uniform(_NOISE, random.random())

    def varied(effect: Effect) -> Effect:
        if isinstance(effect, Noise):
            return _scaled(effect, noise)
        if isinstance(effect, Drift):
            return _scaled(effect, drift)
        return _scaled(effect, geometry) if effect.place == "geometry" else effect

    load, share, side = abs(rig.gearbox.load_torque), random.random(), float(random.uniform(-1, 1))
    harmless: tuple[Effect, ...] = (
        Hum(_HUM * load * 15 ** (share - 1)), Drift(_DRIFT * load * share, 1.5, of="sensor"),
        Offset(_OFFSET * load * side), Gain(1 + _GAIN * side),
        TorqueMeterLowPass(min(_CUTOFF_HZ * 7**share, _BELOW_NYQUIST * sampling_rate / 2)),
    )  # fmt: skip
    chosen = int(random.random() / _HARMLESS)
    return rig.replace(
        effects=(*map(varied, rig.effects), *harmless[chosen : chosen + 1]),
        variants=tuple(tuple(map(varied, one)) for one in rig.variants),
    )


def _scaled(effect: Effect, factor: float) -> Effect:
    """Return an effect whose sizes, which have a neutral value, are multiplied."""
    sizes = {name: getattr(effect, name) for name, one in effect.parameters.items() if one.neutral == 0}
    return effect.with_parameters(**{name: _times(value, factor) for name, value in sizes.items()})


def _times(value: Any, factor: float) -> Any:
    if is_distribution(value):
        plain = to_plain(value, is_parameter=True)
        return from_plain(
            plain | {name: factor * plain.get(name, at) for name, at in (("loc", 0.0), ("scale", 1.0))}
        )
    return tuple(factor * end for end in value) if isinstance(value, tuple) else factor * value
