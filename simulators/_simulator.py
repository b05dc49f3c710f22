"""Simulators of users, in the place of the toolkit's own."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base.checks import is_number, repr_of
from cyclofeat.simulators.defects import LobeDefects
from cyclofeat.simulators.gearbox import CycloidalGearbox

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Simulator(ABC):
    """Abstract base of simulators of users: a machine of theirs in the place of the toolkit's gearbox.

    A subclass is a frozen dataclass, whose fields are its parameters (finite numbers, text, True or False),
    and overrides :meth:`simulate`. In :class:`Rig`, the gearbox then states speed, load and number of lobes.
    All effects on load, speed and torque act as with the toolkit's gearbox. An effect on the machine
    overrides :meth:`Effect.change_simulator`.

    Notes
    -----
    Files hold the name of the class and its fields: it must be defined before they are read, and two modules
    cannot both define one of that name. Where results are kept (``cache``,
    :func:`cyclofeat.gap.prepare_world`), these identify the simulator: take another folder after a change of
    its code.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from cyclofeat.simulators import Rig
    >>> @dataclass(frozen=True)
    ... class Joint(Simulator):
    ...     "Universal joint: a wave twice per turn."
    ...
    ...     depth: float = 0.1
    ...
    ...     def simulate(self, time, angle, speed, load, gearbox, defects):
    ...         return load * (1 + self.depth * np.cos(2 * angle)), angle
    >>> run = Rig(simulator=Joint(0.2)).simulate(duration=1.0, random_state=0)
    >>> float(run.torque_out.max().round(2)), float(run.gearbox.load_torque)
    (26.4, 22.0)
    """

    _known: ClassVar[dict[str, dict[str, type[Simulator]]]] = {}  # by name, then by module

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        Simulator._known.setdefault(cls.__name__, {})[cls.__module__] = cls

    @abstractmethod
    def simulate(
        self, time: Float, angle: Float, speed: Float, load: Float, gearbox: CycloidalGearbox,
        defects: LobeDefects,
    ) -> tuple[ArrayLike, ArrayLike]:  # fmt: skip
        """Return torque and input angle of a machine that already ran before the first sample.

        Equal arguments must give equal results: what is random are effects. A run that diverges raises
        SimulationFailed, and is left out; any other error ends everything.

        Parameters
        ----------
        time : ndarray, shape (n,)
            Instants of the samples in s, evenly spaced from 0.
        angle, speed : ndarray, shape (n,)
            Angle and speed that the input shaft is driven with, in rad and rad/s, with all effects on them.
            The first angle is random.
        load : ndarray, shape (n,)
            Torque in Nm that resists the output, with all effects on it.
        gearbox : CycloidalGearbox
            Nominal speed and load, ``n_lobes``, and what effects change in it.
        defects : LobeDefects
            Worn lobes.

        Returns
        -------
        torque : array-like, shape (n,)
            Torque in Nm on the output, positive for a load that brakes.
        input_angle : array-like, shape (n,)
            Angle of the input shaft in rad, as a tachometer has it.
        """

    def _check(self) -> Self:
        """Return the simulator itself; raise TypeError for no dataclass or a field that no file can hold."""
        if "__dataclass_fields__" not in vars(type(self)):
            raise TypeError(f"{type(self).__name__} must have the decorator @dataclass(frozen=True)")
        for name, value in self._to_dict().items():
            if not (isinstance(value, str | bool) or (is_number(value) and math.isfinite(value))):
                what = f"{name} of {type(self).__name__}"
                raise TypeError(f"{what} must be a finite number, text, True or False, got {repr_of(value)}")
        return self

    def _to_dict(self) -> dict[str, Any]:
        """Return the name of the class under ``"class"``, then the fields by name, as plain values."""
        fields = {one.name: getattr(self, one.name) for one in dataclasses.fields(self)}
        plain = {name: one.item() if isinstance(one, np.generic) else one for name, one in fields.items()}
        return {"class": type(self).__name__, **plain}

    @classmethod
    def _from_dict(cls, content: Mapping[str, Any]) -> Simulator:
        """Return the simulator of a content as :meth:`_to_dict` gives it; fields left out keep their default.

        Raises TypeError or ValueError if it has other fields, or not exactly one module defines its class.
        """
        given = dict(content)
        name = given.pop("class", None)
        known = cls._known.get(name, {})
        if not known:
            raise ValueError(f"simulator must be of a defined class, got {repr_of(name)}: import it first")
        if len(known) > 1:
            modules = " and ".join(sorted(known))
            raise ValueError(f"simulator must be of one class, but {modules} define {name}: rename one")
        (of_name,) = known.values()
        return of_name(**given)._check()
