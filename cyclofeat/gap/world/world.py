"""Training world: prior over rigs, conditions of their recordings, and what is simulated of both."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import hypergeom

from cyclofeat._base.checks import number_pair, one_of, positive, whole
from cyclofeat._base.quantities import TORQUES
from cyclofeat.gap.simulations import MAY_DIFFER, with_may_differ
from cyclofeat.gap.summaries.summarise import Cell, Kinematics
from cyclofeat.gap.world.cells import recording_cells, turn_samples
from cyclofeat.simulators import Drift, Effect, Noise, Rig, known_effects
from cyclofeat.simulators.rig import check_quantity
from cyclofeat.simulators.sampling import scale_size

Float = NDArray[np.float64]

# Assumption: no rig is free of noise, and no brake free of drift.
NOISE_AND_DRIFT: tuple[Effect, ...] = (Noise(0.02), Drift(0.05, 1.5))
# Assumptions: a rig may be made better than ``MAY_DIFFER`` states, or somewhat worse (a factor on all of it),
# and its recordings may all be of one assembly, whose pins they share.
TOLERANCES = (0.0, 1.5)
AROUND = 0.1  # share by which the speeds and loads of a world reach beyond those of recordings
_ONE_ASSEMBLY = 1 / 3
_REVERSED = 1 / 3  # share of the conditions in reverse

Index = Sequence[int] | NDArray[np.intp] | slice


@dataclass(frozen=True)
class Session:
    """Recordings of one rig, as summaries."""

    values: Float = field(repr=False)  # (n_recordings, n_cells)
    conditions: Float  # set-points: speed of the input in RPM, load in Nm, direction (1 or -1)
    counts: NDArray[np.int64] | None = None  # worn lobes, where they are known
    speeds_rpm: Float | None = None  # mean speed of the input by a tachometer, where it is known
    # Recordings with equal numbers are of one assembly; None stands for an assembly each.
    assemblies: NDArray[np.int64] | None = None


@dataclass(frozen=True)
class Rigs:
    """Simulated rigs of a :class:`World`; arrays of shape (n_rigs, ...).

    ``values``, ``conditions``, ``counts`` and ``speeds`` (n_rigs, n_recordings, ...): summaries, NaN where
    the simulation failed; speed in RPM, load in Nm and direction; worn lobes; RPM by a tachometer.
    """

    names: tuple[str, ...]  # of the effects
    size_names: tuple[str, ...]  # of their fitted parameters
    logarithmic: tuple[bool, ...] = field(repr=False)  # whether ``sizes`` holds the logarithm of a parameter
    cells: tuple[str, ...] = field(repr=False)
    numbers: NDArray[np.int64] = field(repr=False)
    machines: NDArray[np.int64] = field(repr=False)  # rigs of one share its runs: keep them together
    values: NDArray[np.float32] = field(repr=False)
    conditions: Float = field(repr=False)
    counts: NDArray[np.int64] = field(repr=False)
    speeds: Float = field(repr=False)
    sizes: Float = field(repr=False)  # parameters on the scale of their fit, NaN where the effect is absent
    world: dict[str, Any] = field(default_factory=dict, repr=False)  # settings: :meth:`World.to_dict`

    def __len__(self) -> int:
        return len(self.numbers)

    @property
    def present(self) -> NDArray[np.bool_]:
        """Presence of each effect, shape (n_rigs, n_effects)."""
        owners = np.array([name.partition(".")[0] for name in self.size_names])
        return np.column_stack(
            [np.isfinite(self.sizes[:, owners == name]).any(axis=1) for name in self.names]
        )

    def of(self, rows: Index | NDArray[np.bool_]) -> Rigs:
        """Return some of the rigs."""
        columns: dict[str, Any] = {
            name: values[rows] for name, values in vars(self).items() if isinstance(values, np.ndarray)
        }
        return dataclasses.replace(self, **columns)

    def session(
        self, rig: int, recordings: Index = slice(None), *, counts: bool = True, tachometer: bool = False
    ) -> Session:
        """Return recordings of the rig in a row, without those that failed, with what is known of them."""
        shown = np.arange(self.values.shape[1])[recordings]
        shown = shown[np.isfinite(self.values[rig, shown, 0])]
        return Session(
            self.values[rig, shown].astype(np.float64),
            self.conditions[rig, shown],
            self.counts[rig, shown] if counts else None,
            self.speeds[rig, shown] if tachometer else None,
        )


@dataclass(frozen=True)
class EffectPrior:
    """Random sets of effects that a model may lack.

    Numbers of effects from 0 to ``most`` are equally probable, as are the sets of each number; sizes follow
    the parameters' priors. As rigs share a machine, the effects that the gearbox answers are drawn first,
    then, for each rig, those on the torque signal, with the probabilities that they have given the first.
    """

    effects: tuple[Effect, ...]
    most: int

    @functools.cached_property
    def _effect_shares(self) -> Float:
        """Probability of a number of effects in the machine (rows) and in all (columns)."""
        n_in_machine, total = np.ogrid[: self.most + 1, : self.most + 1]
        n_answered = sum(effect.needs_simulation() for effect in self.effects)
        shares = hypergeom.pmf(n_in_machine, len(self.effects), n_answered, total)
        return np.asarray(shares / (self.most + 1))

    def in_machine(self, random: np.random.Generator) -> tuple[Effect, ...]:
        """Draw the effects that the gearbox answers."""
        n = random.choice(self.most + 1, p=self._effect_shares.sum(axis=1))
        return self._draw_effects(n, True, random)

    def on_torque(self, n_in_machine: int, random: np.random.Generator) -> tuple[Effect, ...]:
        """Draw the effects on the torque signal of a machine that has ``n_in_machine`` others."""
        shares = self._effect_shares[n_in_machine]
        n = random.choice(self.most + 1, p=shares / shares.sum()) - n_in_machine
        return self._draw_effects(n, False, random)

    def _draw_effects(self, n: int, in_machine: bool, random: np.random.Generator) -> tuple[Effect, ...]:
        possible = [effect for effect in self.effects if effect.needs_simulation() == in_machine]
        chosen = sorted(random.choice(len(possible), n, replace=False)) if n else []
        return tuple(possible[k].draw_parameters(random) for k in chosen)


def missing_effects(rig: Rig) -> tuple[Effect, ...]:
    """Return the known effects with a prior that the rig, or a user's simulator, can but does not have."""
    unanswered = "change_simulator" if rig.simulator is None else "change_gearbox"
    stated = {effect.effect_id for effects in rig.effect_sets() for effect in effects}
    stated |= {"brake_rotor"} if rig.has_brake else set()
    return tuple(
        effect
        for name, effect in known_effects().items()
        if effect.vector_names() and name not in stated and not effect.overrides(unanswered)
    )


def size_names(effects: Iterable[Effect]) -> tuple[str, ...]:
    """Return the names of the fitted parameters of effects, as ``"noise.rms_nm"``."""
    return tuple(f"{effect.effect_id}.{name}" for effect in effects for name in effect.vector_names())


def with_noise_and_drift(rig: Rig, may_differ: Sequence[Effect], tolerance: float = 1.0) -> Rig:
    """Return the rig with so much of what may differ anyway, and with noise and drift where it has none."""
    scaled = []
    for effect in may_differ:
        changed = {}
        for name, parameter in effect.parameters.items():
            value = getattr(effect, name)
            # Distributions stay as they are.
            if parameter.neutral is not None and isinstance(value, int | float | tuple):
                changed[name] = scale_size(parameter, value, tolerance)
        scaled.append(effect.with_parameters(**changed))
    return with_may_differ(rig, (*scaled, *NOISE_AND_DRIFT))


def draw_session(world: World, n_recordings: int, random: np.random.Generator) -> tuple[Session, float]:
    """Draw a session without summaries, at one or three conditions, and the factor on what differs anyway."""
    speeds, loads = random.uniform(*world.speeds_rpm, 3), random.uniform(*world.loads_nm, 3)
    directions = np.where(random.random(3) < _REVERSED, -1, 1)
    n_conditions = 3 if random.random() < 0.5 else 1
    conditions = np.column_stack([speeds, loads, directions])[np.arange(n_recordings) % n_conditions]
    counts = random.choice(np.array(world.defect_counts), n_recordings)
    one_assembly = random.random() < _ONE_ASSEMBLY
    assemblies = np.zeros(n_recordings, dtype=np.int64) if one_assembly else np.arange(n_recordings)
    values = np.zeros((n_recordings, 0))
    return Session(values, conditions, counts, assemblies=assemblies), random.uniform(*TOLERANCES)


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
            "quantity": check_quantity(self.rig, one_of("quantity", self.quantity, TORQUES)),
            "defect_counts": tuple(whole("defect_counts", count, 0) for count in self.defect_counts),
            "wheels": tuple(tuple(wheels) for wheels in self.wheels),
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
        return size_names(self.effects or ())

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

    def to_dict(self) -> dict[str, Any]:
        """Return all settings in types that JSON knows.

        Returns
        -------
        dict from str to object
        """
        plain = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        for name in ("effects", "may_differ"):
            plain[name] = [effect.to_dict() for effect in plain[name]]
        return plain | {"rig": self.rig.to_dict()}

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> World:
        """Return the world of settings as :meth:`to_dict` gives them, also after a way through JSON.

        Parameters
        ----------
        content : mapping from str to object

        Returns
        -------
        World
        """
        given = dict(content)
        simulator = given["rig"].get("simulator")
        given["rig"] = Rig.from_dict(given["rig"])
        for name in ("effects", "may_differ"):
            given[name] = Rig.from_dict({"effects": given[name], "simulator": simulator}).effects
        return cls(**given)


def _check_increasing(name: str, value: Any) -> tuple[float, float]:
    low, high = number_pair(name, value)
    if not 0 < low < high:
        raise ValueError(f"{name} must be a pair (low, high) with 0 < low < high, got {value!r}")
    return low, high
