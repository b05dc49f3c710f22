"""The effects by name: what files, error messages and rankers choose from."""

from __future__ import annotations

import difflib
import inspect
from collections import Counter
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from sklearn.base import clone

from cyclofeat.simulators._checks import short
from cyclofeat.simulators.effects._base import Effect
from cyclofeat.simulators.effects._converter import ClockError, Quantisation
from cyclofeat.simulators.effects._drive import LoadDrift, ProportionalDrift, SpeedWander
from cyclofeat.simulators.effects._gearbox import (
    BearingFriction,
    BrakeRotor,
    CamRunOut,
    Clearance,
    ContactDampingForm,
    ContactDampingScale,
    ContactStiffnessScale,
    LobePitchErrors,
    PinErrors,
    RunOut,
    SleeveFriction,
)
from cyclofeat.simulators.effects._meter import Gain, Hum, Noise, Offset, SensorDrift, TorqueMeterLowPass

_CLASSES: tuple[type[Effect], ...] = (
    PinErrors, LobePitchErrors, RunOut, CamRunOut, Clearance,
    ContactStiffnessScale, ContactDampingScale, ContactDampingForm,
    LoadDrift, SpeedWander,
    SleeveFriction, BearingFriction,
    BrakeRotor, TorqueMeterLowPass,
    SensorDrift, Gain, Offset, Noise, Hum,
    ClockError, Quantisation,
)  # fmt: skip
_LIBRARY: Mapping[str, type[Effect]] = MappingProxyType({kind.effect_id: kind for kind in _CLASSES})
# Other laws of effects that are there: files can name them, but nothing is proposed twice.
_VARIANTS: tuple[type[Effect], ...] = (ProportionalDrift,)
_BY_NAME: Mapping[str, type[Effect]] = {**_LIBRARY, **{kind.effect_id: kind for kind in _VARIANTS}}

# The hooks' own streams of random numbers below that of their effect.
RANGES, GEARBOX, LOAD, SPEED, TORQUE = range(5)


def effect_library() -> Mapping[str, type[Effect]]:
    """All effects of the toolkit by name, in the order of the chain.

    ``effect_library()[name].summary()`` says in one line what each of them is.

    Returns
    -------
    mapping from str to Effect subclass
        Cannot be changed.

    Examples
    --------
    >>> for name, effect in list(effect_library().items())[:2]:
    ...     print(f"{name}: {effect.summary()}")
    pin_errors: Position errors of the pins: every external sleeve sits a little off its place.
    lobe_pitch_errors: Pitch errors of the lobes: each sits a little off its place along the pitch circle.
    """
    return _LIBRARY


def checked_effects(effects: Any) -> tuple[Effect, ...]:
    """Checked copies of the effects, in the order given: who changes his own later changes nothing here."""
    if isinstance(effects, Effect) or not isinstance(effects, Iterable):
        raise TypeError(f"effects must be a sequence of effects, got {effects!r}")
    given = tuple(effects)
    for effect in given:
        if not isinstance(effect, Effect):
            raise TypeError(
                f"effects must hold effects like Hum(amplitude_nm=0.2), got {effect!r}: "
                "effect_library() has them all"
            )
    return tuple(clone(effect).check() for effect in given)


def in_chain_order(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Sorted by place; those of one place stay in the order given."""
    return tuple(sorted(effects, key=lambda effect: effect.place))


def stream_keys(effects: Iterable[Effect]) -> list[tuple[int, ...]]:
    """Key of each effect's random numbers: its name, and how many of that name went before it.

    Nothing else goes in, so that one more effect leaves the numbers of all others as they are.
    """
    seen: Counter[str] = Counter()
    keys = []
    for effect in effects:
        # Bytes of a name are above all numbers that a seed's children are counted with.
        keys.append((*effect.effect_id.encode(), 0, seen[effect.effect_id]))
        seen[effect.effect_id] += 1
    return keys


def child(seed: np.random.SeedSequence, *key: int) -> np.random.SeedSequence:
    """The seed's child of that key; unlike ``spawn`` it leaves the seed as it is."""
    return np.random.SeedSequence(
        entropy=seed.entropy, spawn_key=(*seed.spawn_key, *key), pool_size=seed.pool_size
    )


def effects_from_list(content: Any) -> tuple[Effect, ...]:
    """Effects from a list of objects, as :meth:`Effect.to_dict` writes them.

    Raises
    ------
    TypeError, ValueError
        If something is no effect. The message names its place in the list, key and value.
    """
    if not isinstance(content, list):
        raise TypeError(f'effects must be a list of objects like {{"effect": "hum"}}, got {short(content)}')
    found = []
    for index, item in enumerate(content):
        where = f"effects[{index}]"
        try:
            found.append(_effect_from(item))
        except (TypeError, ValueError) as error:
            raise type(error)(f"{where}: {error}") from None
    return tuple(found)


def _effect_from(content: Any) -> Effect:
    if not isinstance(content, dict) or not isinstance(content.get("effect"), str):
        raise TypeError(f'must be an object like {{"effect": "hum", ...}}, got {short(content)}')
    name = content["effect"]
    kind = _BY_NAME.get(name)
    if kind is None:
        near = _nearest(name, _BY_NAME)
        right = f"did you mean {near!r} ({_one_line(near)})?" if near else f"known are {', '.join(_BY_NAME)}"
        raise ValueError(f"unknown effect {short(name)}: {right}")
    known = inspect.signature(kind.__init__).parameters
    settings = [key for key in known if key != "self"]
    values = {}
    for key, value in content.items():
        if key == "effect":
            continue
        if key not in settings:
            near = _nearest(key, settings)
            right = f"did you mean {near!r}?" if near else f"known are {', '.join(settings)}"
            raise ValueError(f"unknown key {key!r} of {name} with value {short(value)}: {right}")
        parameter = kind.parameters.get(key)
        if value is None and parameter is not None and np.isinf(parameter.high):
            value = np.inf
        values[key] = tuple(value) if isinstance(value, list) else value
    return kind(**values).check()


def _nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name nearest to a misspelt one, if there is one."""
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return near[0] if near else None


def _one_line(name: str) -> str:
    return _BY_NAME[name].summary().partition(":")[0]
