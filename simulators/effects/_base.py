"""What every effect states of itself, and how a fitter, a ranker and a file drive it."""

from __future__ import annotations

import enum
import inspect
import math
import numbers
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri
from sklearn.base import BaseEstimator, clone

from cyclofeat.simulators.gearbox import CycloidalGearbox

Float = NDArray[np.float64]
Fluctuation = Callable[[Float], Float]


class Place(enum.IntEnum):
    """Place of an effect in the chain from the wheels to the recorded number; the chain runs upwards.

    ``GEOMETRY``, ``CONTACT``, ``LOAD_AND_SPEED`` and ``JOINTS`` act in the gearbox, ``SHAFT_AND_METER`` on
    the way to and in the torque meter, ``SENSOR`` on its signal. The converter (ADC) comes last: first the
    instants at which it samples (``ADC_CLOCK``), then the codes that it gives (``ADC_CODES``).
    """

    GEOMETRY = 1
    CONTACT = 2
    LOAD_AND_SPEED = 3
    JOINTS = 4
    SHAFT_AND_METER = 5
    SENSOR = 6
    ADC_CLOCK = 7
    ADC_CODES = 8


@dataclass(frozen=True)
class Uniform:
    """Every value between ``low`` and ``high`` is equally likely."""

    low: float
    high: float

    def quantile(self, share: float) -> float:
        """Value below which a ``share`` (0 to 1) of the probability lies."""
        return self.low + (self.high - self.low) * share

    def log_density(self, value: float) -> float:
        """Natural logarithm of the density at a value; -inf where it is 0."""
        inside = self.low <= value <= self.high
        return -math.log(self.high - self.low) if inside else -math.inf


@dataclass(frozen=True)
class LogUniform:
    """The logarithm of the value is uniform between those of ``low`` and ``high``, both above 0."""

    low: float
    high: float

    def quantile(self, share: float) -> float:
        """Value below which a ``share`` (0 to 1) of the probability lies."""
        return min(self.low * float((self.high / self.low) ** share), self.high)

    def log_density(self, value: float) -> float:
        """Natural logarithm of the density at a value; -inf where it is 0."""
        inside = self.low <= value <= self.high
        return -math.log(value * math.log(self.high / self.low)) if inside else -math.inf


@dataclass(frozen=True)
class Normal:
    """Normal distribution with mean and standard deviation."""

    mean: float
    std: float

    def quantile(self, share: float) -> float:
        """Value below which a ``share`` (0 to 1) of the probability lies."""
        # A random share may be 0 exactly, whose value would be infinite.
        return self.mean + self.std * float(ndtri(min(max(share, 1e-12), 1 - 1e-12)))

    def log_density(self, value: float) -> float:
        """Natural logarithm of the density at a value."""
        z = (value - self.mean) / self.std
        return -0.5 * z * z - math.log(self.std * math.sqrt(2 * math.pi))


Prior = Uniform | LogUniform | Normal


@dataclass(frozen=True)
class EffectParameter:
    """What is known of one numeric parameter of an effect.

    Parameters
    ----------
    unit : str
        Unit; ``"1"`` for a pure number.
    low, high : float
        Bounds, both allowed. An infinite ``high`` allows the value infinity, which files write as ``null``.
    neutral : float or None
        Value at which the effect does nothing; None where another parameter switches it off.
    prior : Uniform, LogUniform, Normal or None
        Assumed distribution over rigs, from which a ranker draws. None for what is not drawn.
    log : bool
        Whether it is fitted, and ranges are drawn, in its logarithm.
    fitted : bool
        Whether a fitter moves it and a ranker draws it; else it is set by hand.
    """

    unit: str
    low: float
    high: float
    neutral: float | None
    prior: Prior | None = None
    log: bool = False
    fitted: bool = True


@dataclass(frozen=True)
class TorqueContext:
    """What an effect on the torque may know of the record besides the torque.

    Parameters
    ----------
    gearbox : CycloidalGearbox, optional
        The gearbox, with all effects on it.
    input_angle : ndarray, shape (n,), optional
        Angle of the input shaft at each sample, in rad: for effects locked to the shaft.
    from_rest : bool
        Whether the machine stood still before the first sample; else it was running as in the record.
    """

    gearbox: CycloidalGearbox | None = None
    input_angle: Float | None = None
    from_rest: bool = False


class Effect(BaseEstimator):
    """Something that a real rig does and the plain simulation does not.

    An abstract class. A subclass names itself (``effect_id``), its place in the chain and its parameters,
    and overrides those of the five hooks through which it acts. Hooks are pure: the same arguments and the
    same state of ``random`` give the same result, and nothing that they are given is changed.

    Parameters are stored as given and checked by :meth:`check`, which the hooks' callers
    (:class:`cyclofeat.simulators.CompositeSimulator`, :class:`cyclofeat.simulators.Rig`) and all methods
    below call. A parameter listed in ``parameters`` is a number, or a range ``(low, high)`` from which
    each assembly draws: log-uniformly where the parameter is fitted in its logarithm, else uniformly.

    Attributes
    ----------
    effect_id : str
        Name in files and reports.
    place : Place
        Place in the chain.
    parameters : mapping from str to EffectParameter
        Unit, bounds, neutral value, prior and scale of each numeric parameter. What else the constructor
        takes are settings.
    separated_by : str
        Measurement that tells this effect from those that look like it.

    Notes
    -----
    Two effects are equal when they are of one class with equal parameters.
    """

    effect_id: ClassVar[str] = ""
    place: ClassVar[Place]
    parameters: ClassVar[Mapping[str, EffectParameter]] = {}
    separated_by: ClassVar[str] = ""

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        if not cls.effect_id:
            raise TypeError(f"{cls.__name__} is abstract: take one of effect_library(), or a subclass of it")
        made: Self = super().__new__(cls)
        return made

    # Hooks.

    def change_gearbox(self, gearbox: CycloidalGearbox, random: np.random.Generator) -> CycloidalGearbox:
        """The gearbox with the effect in it; by default the same."""
        return gearbox

    def load_fluctuation(
        self, gearbox: CycloidalGearbox, duration: float, random: np.random.Generator
    ) -> Fluctuation | None:
        """What the effect adds to the load, or None.

        A function that takes times of shape (n,) in s, from 0 to one second beyond ``duration``, and returns
        Nm of shape (n,).
        """
        return None

    def speed_fluctuation(
        self, gearbox: CycloidalGearbox, duration: float, random: np.random.Generator
    ) -> Fluctuation | None:
        """What the effect adds to the input speed in rad/s, as in :meth:`load_fluctuation`, or None."""
        return None

    def change_torque(
        self,
        torque: Float,
        sampling_rate: float,
        random: np.random.Generator,
        context: TorqueContext | None = None,
    ) -> Float:
        """The torque as it is after this effect; by default the same.

        Parameters
        ----------
        torque : ndarray, shape (n,)
            In Nm.
        sampling_rate : float
            In Hz.
        random : numpy.random.Generator
            Source of all that is random in it.
        context : TorqueContext, optional
            Default: a machine that was running before, of which nothing else is known.

        Returns
        -------
        ndarray, shape (n,)
            In Nm; of another length only where the effect samples at other instants (:meth:`resample`).
        """
        return torque

    def resample(self, values: Float, sampling_rate: float) -> Float:
        """Any other channel of the record at the instants at which this effect samples, shape (n, ...)."""
        return values

    def samples_needed(self, n_samples: int) -> int:
        """Number of samples that the effect must be given to return ``n_samples``."""
        return n_samples

    def check_settings(self) -> None:
        """Raise TypeError or ValueError for settings that cannot be; by default there are none."""

    # For fitters, rankers and files.

    @classmethod
    def summary(cls) -> str:
        """One line that says what the effect is: the first of its documentation."""
        return (inspect.getdoc(cls) or cls.__name__).partition("\n")[0]

    @classmethod
    def needs_simulation(cls) -> bool:
        """Whether the gearbox answers the effect; if not, it can be applied to a torque simulated before."""
        hooks = ("change_gearbox", "load_fluctuation", "speed_fluctuation")
        return any(getattr(cls, hook) is not getattr(Effect, hook) for hook in hooks)

    def check(self) -> Self:
        """The effect itself, if its parameters can be.

        Raises
        ------
        TypeError, ValueError
            If a parameter is of the wrong type or outside its bounds. The message names it.
        """
        for name, parameter in self.parameters.items():
            _check_value(f"{name} of {self.effect_id}", parameter, getattr(self, name))
        self.check_settings()
        return self

    @property
    def has_ranges(self) -> bool:
        """Whether a parameter is a range from which each assembly draws."""
        return any(_is_range(getattr(self, name)) for name in self.parameters)

    def for_assembly(self, random: np.random.Generator) -> Self:
        """The effect with a number drawn from each range.

        Parameters
        ----------
        random : numpy.random.Generator
            Moves on by one number per parameter, whether it is a range or not: a parameter that becomes one
            changes nothing else.
        """
        self.check()
        drawn: dict[str, float] = {}
        for name, parameter in self.parameters.items():
            value, share = getattr(self, name), float(random.random())
            if _is_range(value):
                low, high = (float(end) for end in value)
                between = LogUniform(low, high) if parameter.log else Uniform(low, high)
                drawn[name] = low if low == high else between.quantile(share)
        return self.with_parameters(**drawn)

    def draw_parameters(self, random: np.random.Generator) -> Self:
        """A new effect whose fitted parameters are drawn from their priors.

        Parameters
        ----------
        random : numpy.random.Generator
            Moves on by one number per fitted parameter.

        Examples
        --------
        >>> import numpy as np
        >>> from cyclofeat.simulators.effects import BrakeRotor
        >>> drawn = BrakeRotor().draw_parameters(np.random.default_rng(0))
        >>> 0.002 <= drawn.inertia <= 0.1
        True
        """
        drawn = {}
        for name in self.vector_names():
            parameter = self.parameters[name]
            assert parameter.prior is not None
            value = parameter.prior.quantile(float(random.random()))
            drawn[name] = min(max(value, parameter.low), parameter.high)
        return self.with_parameters(**drawn)

    def with_parameters(self, **values: Any) -> Self:
        """A copy with single parameters changed, checked."""
        changed: Self = clone(self)
        changed.set_params(**values)
        return changed.check()

    def neutral(self) -> Self:
        """A copy that does nothing: its output is its input, to the last bit."""
        values = {name: p.neutral for name, p in self.parameters.items() if p.neutral is not None}
        return self.with_parameters(**values)

    @classmethod
    def vector_names(cls) -> list[str]:
        """Names of the fitted parameters, in the order of :meth:`to_vector`."""
        return [name for name, parameter in cls.parameters.items() if parameter.fitted]

    @classmethod
    def vector_bounds(cls) -> tuple[Float, Float]:
        """Lower and upper bounds of :meth:`to_vector`, each of shape (n_fitted,); infinite where open."""
        fitted = [cls.parameters[name] for name in cls.vector_names()]
        low = [_scaled(parameter, parameter.low) for parameter in fitted]
        high = [_scaled(parameter, parameter.high) for parameter in fitted]
        return np.array(low), np.array(high)

    def to_vector(self) -> Float:
        """The fitted parameters, in logarithms where they are fitted so, shape (n_fitted,).

        Raises
        ------
        ValueError
            If one of them is a range, or one that is fitted in its logarithm is 0 or infinite.

        Examples
        --------
        >>> from cyclofeat.simulators.effects import Offset
        >>> Offset(0.5).to_vector()
        array([0.5])
        """
        self.check()
        found = []
        for name in self.vector_names():
            value, parameter = getattr(self, name), self.parameters[name]
            if _is_range(value):
                raise ValueError(f"{name} of {self.effect_id} must be a number to be fitted, got {value!r}")
            if parameter.log and not 0 < value < math.inf:
                raise ValueError(
                    f"{name} of {self.effect_id} must be above 0 and finite to be fitted in its logarithm, "
                    f"got {value!r}: start elsewhere, for instance at a draw from its prior"
                )
            found.append(_scaled(parameter, value))
        return np.array(found)

    def from_vector(self, vector: ArrayLike) -> Self:
        """A copy with the fitted parameters of a vector, the inverse of :meth:`to_vector`.

        Parameters
        ----------
        vector : array-like, shape (n_fitted,)
            Inside :meth:`vector_bounds`.

        Raises
        ------
        ValueError
            If the vector is of another shape, or a parameter lies outside its bounds: nothing is clipped.
        """
        names = self.vector_names()
        values = np.asarray(vector, dtype=float)
        if values.shape != (len(names),):
            raise ValueError(
                f"vector of {self.effect_id} must have shape ({len(names)},), for {', '.join(names)}, "
                f"got {values.shape}"
            )
        given = {}
        for name, value in zip(names, values.tolist(), strict=True):
            parameter = self.parameters[name]
            number = math.exp(min(value, 700.0)) if parameter.log else value
            # The way through the logarithm and back may leave a bound by rounding.
            for bound in (parameter.low, parameter.high):
                if math.isfinite(bound) and math.isclose(number, bound, rel_tol=1e-12):
                    number = bound
            given[name] = number
        return self.with_parameters(**given)

    def to_dict(self) -> dict[str, Any]:
        """The effect as a file holds it: its name under ``"effect"``, then every parameter and setting.

        Examples
        --------
        >>> from cyclofeat.simulators.effects import TorqueMeterLowPass
        >>> TorqueMeterLowPass(cutoff_hz=(200, 400)).to_dict()
        {'effect': 'torque_meter_low_pass', 'cutoff_hz': [200.0, 400.0], 'order': 2}
        """
        names = list(inspect.signature(type(self).__init__).parameters)[1:]  # without self
        values = {name: _plain(getattr(self, name), name in self.parameters) for name in names}
        return {"effect": self.effect_id, **values}

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Effect) and type(self) is type(other) and self.to_dict() == other.to_dict()

    def __hash__(self) -> int:
        # Parameters may be set later; what is equal still has equal hashes.
        return hash(type(self))


def is_number(value: Any) -> bool:
    """Whether it is a real number and no truth value."""
    return isinstance(value, (numbers.Real, np.number)) and not isinstance(value, (bool, np.bool_))


def check_whole(where: str, value: Any, low: int, high: int) -> None:
    """Raise unless ``value`` is a whole number between ``low`` and ``high``."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{where} must be a whole number, got {value!r}")
    if not low <= value <= high:
        raise ValueError(f"{where} must lie between {low} and {high}, got {value!r}")


def check_phase(where: str, value: Any) -> None:
    """Raise unless ``value`` is None or a finite number of rad."""
    if value is not None and not (is_number(value) and math.isfinite(value)):
        raise ValueError(f"{where} must be a number of rad, or None for a random one, got {value!r}")


def _scaled(parameter: EffectParameter, value: float) -> float:
    """The value in the scale in which it is fitted."""
    if not parameter.log:
        return float(value)
    return math.log(value) if value > 0 else -math.inf


def _is_range(value: Any) -> bool:
    return isinstance(value, (tuple, list, np.ndarray))


def _check_value(where: str, parameter: EffectParameter, value: Any) -> None:
    what = "a number" if parameter.unit == "1" else f"a number of {parameter.unit}"
    ends: Sequence[Any] = value if _is_range(value) else (value,)
    if _is_range(value) and len(ends) != 2:
        raise ValueError(f"{where} must be {what}, or a range (low, high), got {value!r}")
    if not all(map(is_number, ends)):
        raise TypeError(f"{where} must be {what}, or a range (low, high), got {value!r}")
    if not all(parameter.low <= end <= parameter.high for end in ends):  # NaN is neither
        raise ValueError(
            f"{where} must lie between {parameter.low:g} and {parameter.high:g}"
            f"{'' if parameter.unit == '1' else ' ' + parameter.unit}, got {value!r}"
        )
    if len(ends) == 2:
        if ends[0] > ends[1]:
            raise ValueError(f"{where} must be a range (low, high) with low <= high, got {value!r}")
        if not all(map(math.isfinite, ends)) or (parameter.log and ends[0] <= 0 and ends[0] < ends[1]):
            above = "begin above 0 (it is drawn log-uniformly) and end" if parameter.log else "be"
            raise ValueError(f"{where}, as a range, must {above} finite, got {value!r}")


def _plain(value: Any, is_parameter: bool) -> Any:
    """The value in types that JSON knows."""
    if isinstance(value, (tuple, list, np.ndarray)):
        return [_plain(item, is_parameter) for item in value]
    if not is_number(value):
        return value
    if isinstance(value, (int, np.integer)) and not is_parameter:
        return int(value)
    return None if math.isinf(value) else float(value)
