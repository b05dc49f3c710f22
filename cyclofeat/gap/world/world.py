"""Settings of a training world."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.checks import number_pair, one_of, positive, whole
from cyclofeat._base.quantities import TORQUES
from cyclofeat.gap.simulations import MAY_DIFFER
from cyclofeat.gap.summaries.summarise import Cell, Kinematics
from cyclofeat.gap.world.cells import recording_cells, turn_samples
from cyclofeat.gap.world.prior import EffectPrior, missing_effects
from cyclofeat.simulators import Effect, Rig

Float = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class World:
    """Prior over rigs and their sessions, from which a posterior learns.

    Each rig is the model with a random set of effects (none to ``most``, each number with equal probability,
    sizes from their priors), with what may differ anyway (none of it to half as much again), and with at
    least 0.02 Nm of noise and 0.05 Nm of load drift. All recordings of a third of the machines are of one
    assembly, those of the others each of its own. A session has one or three conditions of speed, load and
    direction; a recording is one output turn. All distributions are *assumptions*.

    Parameters
    ----------
    rig : Rig
        The model. Default: paper B's gearbox. Speed and load are drawn.
    effects : sequence of Effect, optional
        Effects that may be missing, with their settings. Default: all known ones that have a prior and that
        the model does not have.
    most : int, default=6
        Largest number of effects at once.
    may_differ : tuple of Effect
        Effects that may differ between recordings without being missing.
    sampling_rate : float, default=25600
        In Hz.
    speeds_rpm, loads_nm : pair of float
        Ranges of the input's speed in RPM and of the load in Nm.
    quantity : {"output_torque", "input_torque"}, default="output_torque"
        What is measured. Input torque is multiplied by the reduction: all torques are referred to the output.
    defect_counts : sequence of int, default=range(8)
        Counts of worn lobes.
    wheels : tuple of tuple of int
        Wheels that may carry the wear, with equal chances.
    n_recordings : int, default=12
        Largest number of recordings of a rig; the smallest is 4.
    n_rigs_per_machine : int, default=8
        Rigs that share the runs of one machine, with other effects on the torque signal.
    random_state : int, default=0

    Notes
    -----
    A reversed recording is that of the gearbox's mirror image: the same gearbox with errors that are mirrored
    too, which makes no difference to their distribution.

    Examples
    --------
    >>> from cyclofeat.simulators import Gain, Noise
    >>> World(effects=(Noise(), Gain()), most=2).size_names
    ('noise.rms_nm', 'gain.factor')
    """

    rig: Rig = Rig()  # noqa: RUF009  (frozen)
    effects: Sequence[Effect] | None = None
    most: int = 6
    may_differ: tuple[Effect, ...] = MAY_DIFFER
    sampling_rate: float = 25_600.0
    speeds_rpm: tuple[float, float] = (350.0, 700.0)
    loads_nm: tuple[float, float] = (10.0, 30.0)
    quantity: str = "output_torque"
    defect_counts: Sequence[int] = tuple(range(8))
    wheels: tuple[tuple[int, ...], ...] = ((0,), (0, 1))
    n_recordings: int = 12
    n_rigs_per_machine: int = 8
    random_state: int = 0

    def __post_init__(self) -> None:
        effects = missing_effects(self.rig) if self.effects is None else tuple(self.effects)
        checked: dict[str, Any] = {
            "effects": effects,
            "most": whole("most", self.most, 0, len(effects)),
            "sampling_rate": positive("sampling_rate", self.sampling_rate, "a number of Hz"),
            "speeds_rpm": _check_increasing("speeds_rpm", self.speeds_rpm),
            "loads_nm": _check_increasing("loads_nm", self.loads_nm),
            "quantity": self.rig.check_quantity(one_of("quantity", self.quantity, TORQUES)),
            "defect_counts": tuple(whole("defect_counts", count, 0) for count in self.defect_counts),
            "n_recordings": whole("n_recordings", self.n_recordings, 1),
            "n_rigs_per_machine": whole("n_rigs_per_machine", self.n_rigs_per_machine, 1),
            "random_state": whole("random_state", self.random_state, 0),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        if len(set(self.names)) < len(self.names):
            raise ValueError(f"effects must be of different kinds, got {', '.join(self.names)}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects that may be missing."""
        return tuple(effect.effect_id for effect in self.effects or ())

    @property
    def size_names(self) -> tuple[str, ...]:
        """Names of their fitted parameters, as ``"noise.rms_nm"``."""
        return tuple(f"{e.effect_id}.{name}" for e in self.effects or () for name in e.vector_names())

    @property
    def logarithmic(self) -> tuple[bool, ...]:
        """Return for each parameter whether it is fitted in its logarithm."""
        return tuple(e.parameters[name].log for e in self.effects or () for name in e.vector_names())

    @property
    def n_lobes(self) -> int:
        """Number of lobes of the model's discs."""
        return int(self.rig.gearbox.n_lobes)

    @functools.cached_property
    def prior(self) -> EffectPrior:
        """Prior of the sets of effects."""
        return EffectPrior(tuple(self.effects or ()), self.most)

    @functools.cached_property
    def described_cells(self) -> tuple[Cell, ...]:
        """Summaries of a recording, the same at all speeds; bands are those at the lowest."""
        conditions = Kinematics(self.sampling_rate, self.speeds_rpm[0] / 60, self.n_lobes)
        _, cells = recording_cells(np.zeros((1, turn_samples(conditions)), dtype=np.float32), conditions)
        return tuple(cells)

    @property
    def cells(self) -> tuple[str, ...]:
        """Names of the summaries of a recording."""
        return tuple(f"{cell.family}: {cell.name}" for cell in self.described_cells)

    def sizes_of(self, effects: Sequence[Effect]) -> Float:
        """Return the fitted parameters of effects on the scale of their fit, NaN where one is absent."""
        sizes = dict.fromkeys(self.size_names, np.nan)
        for effect in effects:
            for name, value in zip(effect.vector_names(), effect.to_vector(), strict=True):
                sizes[f"{effect.effect_id}.{name}"] = value
        return np.array(list(sizes.values()))

    def to_dict(self) -> dict[str, Any]:
        """Return all settings in types that JSON knows."""
        plain = {
            name: getattr(self, name)
            for name in ("most", "sampling_rate", "speeds_rpm", "loads_nm", "quantity", "defect_counts",
                         "wheels", "n_recordings", "n_rigs_per_machine", "random_state")
        }  # fmt: skip
        listed = {"effects": self.effects or (), "may_differ": self.may_differ}
        return {
            "rig": self.rig.to_dict(),
            **{name: [effect.to_dict() for effect in effects] for name, effects in listed.items()},
            **plain,
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> World:
        """Return the world of settings as :meth:`to_dict` gives them, also after a way through JSON."""
        given = dict(content)
        simulator = given["rig"].get("simulator")
        given["rig"] = Rig.from_dict(given["rig"])
        for name in ("effects", "may_differ"):
            given[name] = Rig.from_dict({"effects": given[name], "simulator": simulator}).effects
        for name in ("speeds_rpm", "loads_nm", "defect_counts"):
            given[name] = tuple(given[name])
        given["wheels"] = tuple(tuple(wheels) for wheels in given["wheels"])
        return cls(**given)


def _check_increasing(name: str, value: Any) -> tuple[float, float]:
    low, high = number_pair(name, value)
    if not 0 < low < high:
        raise ValueError(f"{name} must be a pair (low, high) with 0 < low < high, got {value!r}")
    return low, high
