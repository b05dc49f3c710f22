"""Base class of the effects, with their hooks and place in the chain, and the values of their parameters."""

from __future__ import annotations

import copy
import difflib
import functools
import inspect
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray
from scipy import stats
from sklearn.base import BaseEstimator

from cyclofeat._base.checks import is_number, one_of, repr_of
from cyclofeat._base.quantities import from_1
from cyclofeat.simulators.gearbox import CycloidalGearbox
from cyclofeat.simulators.motor import Motor

Float = NDArray[np.float64]
Fluctuation = Callable[[Float], Float]
Added = Fluctuation | None  # by an effect to load or speed

# Places in the chain from the nominal gearbox to the recorded number, which runs in this order: nominal
# values; in the gearbox; between gearbox and signal; on the signal of the torque meter; in the converter.
# The motor is the other end.
PLACES = (
    "nominal", "geometry", "contact", "load_and_speed", "joints",
    "shaft_and_meter", "sensor", "adc_clock", "adc_codes", "motor",
)  # fmt: skip

# Hooks with the place of an effect that overrides one of them.
_PLACE_OF_HOOK = {
    "change_gearbox": "geometry",
    "change_simulator": "geometry",
    "load_fluctuation": "load_and_speed",
    "speed_fluctuation": "load_and_speed",
    "change_torque": "sensor",
    "change_motor": "motor",
}
HOOKS = (*_PLACE_OF_HOOK, "resample")

# Distributions of scipy that rigs and files may contain.
_DISTRIBUTIONS = ("uniform", "loguniform", "norm", "truncnorm", "lognorm", "rayleigh")
# Probabilities of quantiles are limited to this distance from 0 and 1, where quantiles may be infinite.
_LEAST_SHARE = 1e-12
# Key under which files hold wheels, counted from 1.
_WHEELS = "wheels_from_1"


@dataclass(frozen=True)
class TorqueContext:
    """What effects on the torque need to know of a record, apart from its torque."""

    gearbox: CycloidalGearbox | None = None  #: with all effects on it
    input_angle: Float | None = None  #: angle of the input shaft at each sample, in rad


@functools.lru_cache
def _probabilities(distribution: Any, low: float, high: float) -> tuple[float, float]:
    """Return the probabilities below two bounds: thousands of draws are of few distributions."""
    return float(distribution.cdf(low)), float(distribution.cdf(high))


@dataclass(frozen=True)
class EffectParameter:
    """Unit, bounds and prior of one numeric parameter of an effect.

    Parameters
    ----------
    unit : str
        Unit; ``"1"`` for a pure number.
    low, high : float
        Bounds, both allowed. An infinite ``high`` allows the value infinity, which files write as ``null``.
    neutral : float, optional
        Value at which the effect does nothing. None: another parameter switches the effect off.
    prior : frozen distribution of scipy.stats, optional
        Assumed distribution over rigs, from which a search for missing effects draws. None: set by hand,
        neither fitted nor drawn.
    log : bool, default False
        Fit the parameter, and draw from ranges, in its logarithm.
    default : float, optional
        Default in the constructor of a class that defines none. None: the median of the prior, or the
        neutral value.
    """

    unit: str
    low: float
    high: float
    neutral: float | None = None
    prior: Any = None
    log: bool = False
    default: float | None = None

    def draw(self, value: Any, share: float) -> float:
        """Return the quantile of a value.

        Parameters
        ----------
        value : float, (low, high) or frozen distribution of scipy.stats
            A number is returned unchanged; a range is log-uniform if ``log`` is true, else uniform; a
            distribution is truncated to the bounds.
        share : float
            Probability, from 0 to 1.

        Returns
        -------
        float
        """
        if is_distribution(value):
            below, up_to = _probabilities(value, self.low, self.high)
            share = min(max(below + (up_to - below) * share, _LEAST_SHARE), 1 - _LEAST_SHARE)
            return min(max(float(value.ppf(share)), self.low), self.high)
        if not is_range(value):
            return float(value)
        low, high = (float(end) for end in value)
        if low == high:
            return low
        number = low * (high / low) ** share if self.log else low + (high - low) * share
        return min(max(number, low), high)

    def _check(self, where: str, value: Any) -> None:
        """Raise unless a number or range, or at least half of a distribution, lies within the bounds."""
        bounds = f"{self.low:g} and {self.high:g}{'' if self.unit == '1' else ' ' + self.unit}"
        if is_distribution(value):
            if value.dist.name not in _DISTRIBUTIONS:
                names = ", ".join(_DISTRIBUTIONS)
                raise ValueError(f"{where} must be one of scipy's {names}, got {value.dist.name}")
            inside = float(value.cdf(self.high)) - float(value.cdf(self.low))
            if not inside >= 0.5:  # also true for NaN, from arguments that scipy rejects
                raise ValueError(
                    f"{where} must lie between {bounds}, where {value_text(value)} has {inside:.0%}"
                )
            return
        unit = "" if self.unit == "1" else f" of {self.unit}"
        wrong = f"{where} must be a number{unit}, a range (low, high) or a distribution, got {repr_of(value)}"
        ends: Sequence[Any] = value if is_range(value) else (value,)
        if is_range(value) and len(ends) != 2:
            raise ValueError(wrong)
        if not all(map(is_number, ends)):
            raise TypeError(wrong)
        if not all(self.low <= end <= self.high for end in ends):  # also for NaN
            raise ValueError(f"{where} must lie between {bounds}, got {value!r}")
        if not is_range(value):
            return
        low, high = ends
        if low > high:
            raise ValueError(f"{where} must be a range (low, high) with low <= high, got {value!r}")
        if not (math.isfinite(low) and math.isfinite(high)) or (self.log and low <= 0 and low < high):
            above = "begin above 0 (it is drawn log-uniformly) and end" if self.log else "be"
            raise ValueError(f"{where}, as a range, must {above} finite, got {value!r}")


class Of:
    """Attribute of a class of effects that depends on the setting ``of``: one value for each setting."""

    def __init__(self, **values: Any) -> None:
        self.values = values

    def __get__(self, effect: Any, kind: Any = None) -> Any:
        if effect is None:
            return self
        return self.values[one_of(f"'of' of {type(effect).__name__}", effect.of, self.values)]


class Effect(BaseEstimator):
    """Abstract base of the effects: a deviation of a real rig from the plain simulation.

    A subclass states its parameters and overrides at least one hook: :meth:`change_gearbox`,
    :meth:`change_simulator`, :meth:`load_fluctuation`, :meth:`speed_fluctuation`, :meth:`change_torque` or
    :meth:`change_motor`.
    Hooks are pure: the same arguments and the same state of ``random`` give the same result, and arguments
    stay unchanged.

    A parameter is a number; a range ``(low, high)``, from which each assembly draws, log-uniformly where the
    parameter is fitted in its logarithm, else uniformly; or a frozen distribution of scipy (uniform,
    loguniform, norm, truncnorm, lognorm or rayleigh), truncated to the parameter's bounds.
    :class:`cyclofeat.simulators.Rig` checks the values. Effects of one class with equal parameters are equal.

    Attributes
    ----------
    effect_id : str
        Name in files and reports. Default: the class's name in snake case.
    summary : str
        The effect in one sentence. Default: the first line of the class's documentation.
    place : str
        Place in the chain: ``"nominal"``, ``"geometry"`` (default for changes of the gearbox), ``"contact"``,
        ``"load_and_speed"`` (default for load or speed), ``"joints"``, ``"shaft_and_meter"``, ``"sensor"``
        (default for the torque), ``"adc_clock"``, ``"adc_codes"`` or ``"motor"`` (default for the motor). An
        effect that changes several must state it.
    parameters : mapping from str to EffectParameter
        Numeric parameters by name; those with a prior are fitted.
    settings : mapping from str to object
        Defaults of settings by name. A class without a constructor gets one that takes its parameters and
        settings.
    separated_by : str
        Measurement that tells the effect from those that look like it.
    shows_as : str, default ""
        What records at one speed, load and direction show of the effect, such as ``"mean torque"``. Effects
        that show as the same look alike; ``""`` for an effect without look-alikes.
    moves_mean : bool, default False
        True if the effect also moves the mean torque, which then says little about effects that show as it.
    proposed : bool, default True
        False for an effect that a search which adds one effect at a time leaves out.

    Examples
    --------
    >>> from scipy.stats import loguniform
    >>> from cyclofeat.simulators import Rig
    >>> class SpeedOffset(Effect):
    ...     "Speed of the input that is off by a constant."
    ...
    ...     parameters = {
    ...         "shift": EffectParameter("rad/s", -10, 10, neutral=0.0, prior=loguniform(0.01, 1))
    ...     }
    ...
    ...     def change_gearbox(self, gearbox, random):
    ...         return gearbox.replace(input_speed=gearbox.input_speed + self.shift)
    >>> Rig(effects=[SpeedOffset(0.5)]).draw(0).gearbox.input_speed - Rig().gearbox.input_speed
    0.5
    """

    effect_id: ClassVar[str] = ""
    summary: ClassVar[str] = ""
    place: ClassVar[str]
    parameters: ClassVar[Mapping[str, EffectParameter]] = {}
    settings: ClassVar[Mapping[str, Any]] = {}
    separated_by: ClassVar[str] = ""
    shows_as: ClassVar[str] = ""
    moves_mean: ClassVar[bool] = False
    proposed: ClassVar[bool] = True

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "effect_id" not in vars(cls):
            cls.effect_id = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__).lower()
        if "summary" not in vars(cls):
            cls.summary = (inspect.getdoc(cls) or cls.__name__).partition("\n")[0]
        if not hasattr(cls, "place"):
            places = {
                place
                for hook, place in _PLACE_OF_HOOK.items()
                if getattr(cls, hook) is not getattr(Effect, hook)
            }
            if len(places) == 1:
                cls.place = places.pop()
        if cls.__init__ is object.__init__ or hasattr(cls.__init__, "__signature__"):
            defaults: dict[str, Any] = {}
            for key, parameter in cls.parameters.items():
                defaults[key] = parameter.neutral if parameter.default is None else parameter.default
                if parameter.default is None and parameter.prior is not None:
                    defaults[key] = float(parameter.prior.median())
            defaults |= cls.settings
            kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
            arguments = [inspect.Parameter(name, kind, default=value) for name, value in defaults.items()]
            signature = inspect.Signature([inspect.Parameter("self", kind), *arguments])

            def __init__(self: Any, *args: Any, **kwargs: Any) -> None:
                bound = signature.bind(self, *args, **kwargs)
                bound.apply_defaults()
                for name in defaults:
                    setattr(self, name, bound.arguments[name])

            __init__.__signature__ = signature  # type: ignore[attr-defined]
            cls.__init__ = __init__  # type: ignore[method-assign]
        if vars(cls).get("__doc__"):
            _complete_documentation(cls)

    def change_gearbox(self, gearbox: CycloidalGearbox, random: Generator) -> CycloidalGearbox:
        """Return the gearbox with the effect on it; by default the same.

        Parameters
        ----------
        gearbox : CycloidalGearbox
        random : numpy.random.Generator

        Returns
        -------
        CycloidalGearbox
        """
        return gearbox

    def change_simulator(self, simulator: Any, random: Generator) -> Any:
        """Return a user's simulator with the effect on it, mostly by :func:`dataclasses.replace`.

        Parameters
        ----------
        simulator : Simulator
        random : numpy.random.Generator

        Returns
        -------
        Simulator
            By default the same.
        """
        return simulator

    def load_fluctuation(self, gearbox: CycloidalGearbox, duration: float, random: Generator) -> Added:
        """Return a function of time that the effect adds to the load, or None.

        Parameters
        ----------
        gearbox : CycloidalGearbox
            With all effects on it.
        duration : float
            In s.
        random : numpy.random.Generator

        Returns
        -------
        callable or None
            Takes times of shape (n,) in s, from 0 to one second beyond ``duration``, and returns Nm of shape
            (n,).
        """
        return None

    def speed_fluctuation(self, gearbox: CycloidalGearbox, duration: float, random: Generator) -> Added:
        """Return a function of time that the effect adds to the input speed, or None.

        Parameters
        ----------
        gearbox, duration, random
            See :meth:`load_fluctuation`.

        Returns
        -------
        callable or None
            As that of :meth:`load_fluctuation`, in rad/s.
        """
        return None

    def change_torque(
        self, torque: Float, sampling_rate: float, random: Generator, context: TorqueContext | None = None
    ) -> Float:
        """Return the torque after this effect; by default the same.

        Parameters
        ----------
        torque : ndarray, shape (n,)
            In Nm.
        sampling_rate : float
            In Hz.
        random : numpy.random.Generator
        context : TorqueContext, optional
            Default: an unknown machine that has run before.

        Returns
        -------
        ndarray, shape (n,)
            In Nm; of another length only for an effect that samples at other instants (:meth:`resample`).
        """
        return torque

    def change_motor(self, motor: Motor, random: Generator) -> Motor:
        """Return the motor with the effect on it; by default the same.

        Parameters
        ----------
        motor : Motor
            That of the effect before; ``Motor()`` for the first effect of a rig that changes it.
        random : numpy.random.Generator

        Returns
        -------
        Motor
        """
        return motor

    def resample(self, values: Float, sampling_rate: float) -> Float:
        """Return another channel at the instants at which this effect samples; by default the same.

        Parameters
        ----------
        values : ndarray, shape (n, ...)
        sampling_rate : float
            In Hz.

        Returns
        -------
        ndarray, shape (m, ...)
        """
        return values

    def samples_needed(self, n_samples: int) -> int:
        """Return the number of samples from which the effect makes ``n_samples``; by default as many.

        Parameters
        ----------
        n_samples : int

        Returns
        -------
        int
        """
        return n_samples

    def check_settings(self) -> None:
        """Raise TypeError or ValueError for wrong settings; by default accept all."""

    def needs_simulation(self) -> bool:
        """Return True unless the effect can be applied to a torque simulated before.

        Returns
        -------
        bool
        """
        return any(self.overrides(hook) for hook in _PLACE_OF_HOOK if hook != "change_torque")

    def overrides(self, hook: str) -> bool:
        """Return True if the effect overrides a hook.

        Parameters
        ----------
        hook : str
            Name of the method.

        Returns
        -------
        bool
        """
        return getattr(type(self), hook) is not getattr(Effect, hook)

    def _check(self) -> Self:
        """Return the effect itself; raise TypeError or ValueError for a wrong parameter or setting."""
        for name, parameter in self.parameters.items():
            parameter._check(f"{name} of {self.effect_id}", getattr(self, name))
        self.check_settings()
        return self

    @property
    def has_spread(self) -> bool:
        """True if a parameter is a range or a distribution."""
        return any(is_spread(getattr(self, name)) for name in self.parameters)

    def draw_parameters(self, random: Generator) -> Self:
        """Return a copy with fitted parameters drawn from their priors.

        Parameters
        ----------
        random : numpy.random.Generator
            Advances by one number per fitted parameter.

        Returns
        -------
        Effect
        """
        drawn = {
            name: parameter.draw(parameter.prior, float(random.random()))
            for name, parameter in self.parameters.items()
            if parameter.prior is not None
        }
        return self.with_parameters(**drawn)

    def with_parameters(self, **values: Any) -> Self:
        """Return a checked copy with single parameters or settings changed.

        Parameters
        ----------
        **values : object
            New values by name.

        Returns
        -------
        Effect
        """
        changed = copy.copy(self)
        changed.set_params(**values)
        return changed._check()

    def vector_names(self) -> list[str]:
        """Return the names of the fitted parameters, in the order of :meth:`to_vector`.

        Returns
        -------
        list of str
        """
        return [name for name, parameter in self.parameters.items() if parameter.prior is not None]

    @property
    def main_parameter(self) -> str:
        """Name of the fitted parameter that says how strong the effect is: the first that can be neutral."""
        names = self.vector_names()
        return next((name for name in names if self.parameters[name].neutral is not None), names[0])

    def vector_bounds(self) -> tuple[Float, Float]:
        """Return lower and upper bounds of :meth:`to_vector`.

        Returns
        -------
        low, high : ndarray, shape (n_fitted,)
        """
        fitted = [self.parameters[name] for name in self.vector_names()]
        low, high = (
            np.array([_fit_value(one, getattr(one, end)) for one in fitted]) for end in ("low", "high")
        )
        return low, high

    def to_vector(self) -> Float:
        """Return the fitted parameters, in logarithms where they are fitted so.

        Returns
        -------
        ndarray, shape (n_fitted,)
        """
        self._check()
        vector = []
        for name in self.vector_names():
            value, parameter, what = getattr(self, name), self.parameters[name], f"{name} of {self.effect_id}"
            if is_spread(value):
                raise ValueError(f"{what} must be a number to be fitted, got {value_text(value)}")
            if parameter.log and not 0 < value < math.inf:
                raise ValueError(f"{what} must be above 0 and finite to be fitted, got {value!r}")
            vector.append(_fit_value(parameter, value))
        return np.array(vector)

    def from_vector(self, vector: ArrayLike) -> Self:
        """Return a copy with the fitted parameters of a vector, the inverse of :meth:`to_vector`.

        Parameters
        ----------
        vector : array-like, shape (n_fitted,)
            Inside :meth:`vector_bounds`.

        Returns
        -------
        Effect
        """
        names = self.vector_names()
        values = np.asarray(vector, dtype=float)
        if values.shape != (len(names),):
            raise ValueError(f"vector of {self.effect_id} must hold {len(names)} values, got {values.shape}")
        parameters = {}
        for name, value in zip(names, values.tolist(), strict=True):
            parameter = self.parameters[name]
            number = math.exp(min(value, 700.0)) if parameter.log else value
            # The logarithm and back may exceed a bound by rounding.
            for bound in (parameter.low, parameter.high):
                if math.isfinite(bound) and math.isclose(number, bound, rel_tol=1e-12):
                    number = bound
            parameters[name] = number
        return self.with_parameters(**parameters)

    def to_dict(self) -> dict[str, Any]:
        """Return the effect as a file holds it: its name under ``"effect"``, then parameters and settings.

        Returns
        -------
        dict
            In types that JSON knows.

        Examples
        --------
        >>> from cyclofeat.simulators.effects import TorqueMeterLowPass
        >>> TorqueMeterLowPass(cutoff_hz=(200, 400)).to_dict()
        {'effect': 'torque_meter_low_pass', 'cutoff_hz': [200.0, 400.0], 'order': 2}
        """
        values = {
            name: to_plain(getattr(self, name), is_parameter=name in self.parameters)
            for name in file_keys(self)
        }
        return {"effect": self.effect_id, **settings_to_file(values)}

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Effect) and type(self) is type(other) and self.to_dict() == other.to_dict()

    def __hash__(self) -> int:
        return hash(type(self))  # parameters may be set later

    def __repr__(self) -> str:
        kind: Any = type(self)
        arguments = _arguments(kind)
        texts = {name: value_text(getattr(self, name)) for name in arguments}
        changed = [name for name in texts if texts[name] != value_text(arguments[name].default)]
        return f"{type(self).__name__}({', '.join(f'{name}={texts[name]}' for name in changed)})"


def draw_for_assembly(effect: Effect, random: Generator) -> Effect:
    """Return a copy of an effect with a number drawn from each range and distribution.

    ``random`` advances by one number per parameter, so that ranges do not change the draws of others.
    """
    effect._check()
    drawn = {
        name: parameter.draw(getattr(effect, name), float(random.random()))
        for name, parameter in effect.parameters.items()
    }
    return effect.with_parameters(**drawn)


def file_keys(effect: Effect) -> list[str]:
    """Return the parameters and settings that a file holds: not ``of`` where the effect's name states it."""
    kind: Any = type(effect)  # mypy takes the instances' hash for that of the class
    return [name for name in _arguments(kind) if name != "of" or not isinstance(kind.effect_id, Of)]


@functools.lru_cache
def _arguments(kind: type[Effect]) -> Mapping[str, inspect.Parameter]:
    return inspect.signature(kind).parameters


def _fit_value(parameter: EffectParameter, value: float) -> float:
    """Return a value on the scale of the fit; minus infinity for the logarithm of 0."""
    if not parameter.log:
        return float(value)
    return math.log(value) if value > 0 else -math.inf


def _complete_documentation(cls: type[Effect]) -> None:
    """Complete the documentation of a class: its separating measurement, and parameters without an entry."""
    text = inspect.cleandoc(cls.__doc__ or "")
    entries = []
    for name, parameter in cls.parameters.items() if isinstance(cls.parameters, Mapping) else ():
        if f"{name} : " in text or not isinstance(parameter, EffectParameter):
            continue
        default = inspect.signature(cls).parameters[name].default
        unit = "A pure number" if parameter.unit == "1" else f"In {parameter.unit}"
        neutral = "" if parameter.neutral is None else f"; {parameter.neutral:g} is neutral"
        file = " (infinity is ``null`` in files)" if math.isinf(parameter.high) else ""
        drawn = "" if parameter.prior is not None else " Set by hand: neither fitted nor drawn from a prior."
        entries.append(
            f"{name} : float or (low, high), default {default:g}\n"
            f"    {unit}, {parameter.low:g} to {parameter.high:g}{neutral}{file}.{drawn}"
        )
    head, *sections = re.split(r"(?=\n\n[A-Z][A-Za-z ]+\n-{3,}\n)", text, maxsplit=1)
    if isinstance(cls.separated_by, str) and cls.separated_by:
        head += f"\n\nSeparating measurement: {cls.separated_by}."
    title, rest = "\n\nParameters\n----------", "".join(sections)
    if entries:
        head = "\n".join([head + title, *entries])
        rest = rest.removeprefix(title)
    cls.__doc__ = head + rest


def is_distribution(value: Any) -> bool:
    """Return True for a frozen distribution of scipy."""
    return hasattr(value, "dist") and hasattr(value, "ppf")


def is_range(value: Any) -> bool:
    """Return True for a sequence, which as a parameter must be (low, high)."""
    return isinstance(value, (tuple, list, np.ndarray))


def is_spread(value: Any) -> bool:
    """Return True for a range or a distribution."""
    return is_range(value) or is_distribution(value)


def to_plain(value: Any, *, is_parameter: bool) -> Any:
    """Return the value in types that JSON knows."""
    if is_distribution(value):
        return {"distribution": value.dist.name, **_distribution_arguments(value)}
    if is_range(value):
        return [to_plain(item, is_parameter=is_parameter) for item in value]
    if not is_number(value):
        return value
    if isinstance(value, (int, np.integer)) and not is_parameter:
        return int(value)
    return None if math.isinf(value) else float(value)


def from_plain(value: Any) -> Any:
    """Return the value of a parameter from :func:`to_plain`'s."""
    if isinstance(value, list):
        return tuple(value)
    if not isinstance(value, dict):
        return value
    given = dict(value)
    name = given.pop("distribution", None)
    if name not in _DISTRIBUTIONS:
        raise ValueError(
            f'must be a number, [low, high] or {{"distribution": NAME, ...}} with one of '
            f"{', '.join(_DISTRIBUTIONS)}, got {repr_of(value)}"
        )
    distribution = getattr(stats, name)
    shapes = _shapes(distribution)
    reject_unknown(given, (*shapes, "loc", "scale"), of=f" of {name}")
    for key, number in given.items():
        if not is_number(number):
            raise TypeError(f"{key} of {name} must be a number, got {repr_of(number)}")
    if missing := [key for key in shapes if key not in given]:
        raise ValueError(f"{name} needs {', '.join(missing)}, got {repr_of(value)}")
    return distribution(**given)


def value_text(value: Any) -> str:
    """Return the value as code."""
    if not is_distribution(value):
        return repr(value)
    arguments = ", ".join(f"{key}={number:g}" for key, number in _distribution_arguments(value).items())
    return f"{value.dist.name}({arguments})"


def suggest_key(key: str, known: Iterable[str], prefix: str = "") -> str:
    """Return the nearest known key, or all of them, for an error message."""
    near = difflib.get_close_matches(key, names := list(known), n=1, cutoff=0.5)
    return f"did you mean {prefix + near[0]!r}?" if near else f"known are {', '.join(names)}"


def reject_unknown(given: Mapping[str, Any], known: Iterable[str], prefix: str = "", of: str = "") -> None:
    """Raise ValueError for the first unknown key; the message has the nearest."""
    names = list(known)
    for key, value in given.items():
        if key not in names:
            right = suggest_key(key, names, prefix)
            raise ValueError(f"unknown key {prefix + key!r}{of} with value {repr_of(value)}: {right}")


def _shapes(distribution: Any) -> list[str]:
    return [name.strip() for name in (distribution.shapes or "").split(",") if name.strip()]


def _distribution_arguments(distribution: Any) -> dict[str, float]:
    """Return shapes, location and scale of a frozen distribution by name."""
    names = [*_shapes(distribution.dist), "loc", "scale"]
    given = dict(zip(names, distribution.args, strict=False)) | distribution.kwds
    defaults = {"loc": 0.0, "scale": 1.0}
    return {name: float(given.get(name, defaults.get(name, math.nan))) for name in names}


def settings_to_file(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings as files hold them: there wheels count from 1, and their key says so."""
    return {
        _WHEELS if name == "wheels" else name: from_1(value)
        if name == "wheels" and not isinstance(value, str)
        else value
        for name, value in settings.items()
    }


def settings_of_file(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings that a file holds as Python takes them; raise ValueError for wheels not from 1."""
    if "wheels" in settings:
        raise ValueError(f"unknown key 'wheels': name it {_WHEELS!r} and count wheels from 1")
    given = {"wheels" if name == _WHEELS else name: value for name, value in settings.items()}
    wheels = given.get("wheels", "")
    if not isinstance(wheels, str):
        if wheels not in ([1], [2], [1, 2]):
            raise ValueError(f"{_WHEELS} must be [1], [2] or [1, 2], got {repr_of(wheels)}")
        given["wheels"] = tuple(wheel - 1 for wheel in wheels)
    return given
