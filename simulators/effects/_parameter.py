"""Values of an effect's parameters: numbers, ranges, and frozen distributions of scipy."""

from __future__ import annotations

import difflib
import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from cyclofeat._base.checks import is_number, repr_of
from cyclofeat._base.quantities import from_1

# Distributions of scipy that rigs and files may contain.
_DISTRIBUTIONS = ("uniform", "loguniform", "norm", "truncnorm", "lognorm", "rayleigh")
# Probabilities of quantiles are limited to this distance from 0 and 1, where quantiles may be infinite.
_LEAST_SHARE = 1e-12


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
        return {"distribution": value.dist.name, **_arguments(value)}
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
    arguments = ", ".join(f"{key}={number:g}" for key, number in _arguments(value).items())
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


def _arguments(distribution: Any) -> dict[str, float]:
    """Return shapes, location and scale of a frozen distribution by name."""
    names = [*_shapes(distribution.dist), "loc", "scale"]
    given = dict(zip(names, distribution.args, strict=False)) | distribution.kwds
    defaults = {"loc": 0.0, "scale": 1.0}
    return {name: float(given.get(name, defaults.get(name, math.nan))) for name in names}


_WHEELS = "wheels_from_1"


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
