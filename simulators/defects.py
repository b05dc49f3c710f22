"""Worn and removed lobes of a gearbox."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from cyclofeat._base.checks import check_type, is_number, is_whole, list_members, number, positive, repr_of
from cyclofeat.simulators.gearbox import CycloidalGearbox

MOST_WEAR_UM = 200.0
_WEAR_SHARE, _WEAR_CENTRE = 0.6, 0.5


@dataclass(frozen=True)
class LobeDefects:
    """Worn and removed lobes, counted from 0; lobe k spans 24k to 24(k+1) deg, its tip at 24k.

    Build it with :meth:`healthy`, :meth:`worn`, :meth:`pitted` or :meth:`removed`. A worn lobe has either the
    papers' chord (``depth``) or radial wear (``wear_um``).

    Parameters
    ----------
    worn_lobes, removed_lobes : tuple of int
        Sorted, distinct lobe indices.
    wheels : tuple of int
        Wheels that carry the defects: ``(0,)``, ``(1,)`` or ``(0, 1)``.
    depth : float
        Severity of the wear between 0 (healthy) and 1 (the papers' chord): the share of the lobe's width
        over which the half from tip to pit is worn down to the chord. The contact forces of both parts add.
        Must be 0 with ``wear_um``.
    wear_um : float or tuple of float, optional
        Radial wear in um, 0 to 200, the same for all worn lobes or one for each: how much deeper than into a
        healthy flank a pin sinks where the wear is deepest.
    wear_share : float, default 0.6
        Share of the flank, the half from tip to pit, with radial wear, above 0 up to 1. It is a share of the
        flank's angle, over which a contact moves evenly with the input.
    wear_centre : float, default 0.5
        Place of the deepest wear, from 0 (tip) to 1 (pit between two lobes).

    Raises
    ------
    TypeError, ValueError
        If a parameter is of the wrong type or outside its range, or if ``depth`` and ``wear_um`` are both
        given; the message names it.

    Notes
    -----
    Paper B wears both wheels. Equal lobes of the two wheels act at the same moment, so that the output torque
    does not show which wheel is worn; ``defect_count`` counts distinct lobe indices.

    Radial wear has the shape of a raised cosine squared, wear_um ((1 - cos(2 pi x)) / 2)^2, where x runs from
    0 to 1 over the worn part: depth, slope and curvature are continuous at both ends. The path of a pin's
    centre lies deeper by it, along its normal; the worn outline is what a pin on that path leaves. Contacts
    keep the stiffness of the healthy flank.
    """

    worn_lobes: tuple[int, ...] = ()
    removed_lobes: tuple[int, ...] = ()
    wheels: tuple[int, ...] = (0, 1)
    depth: float = 1.0
    wear_um: float | Sequence[float] | None = None
    wear_share: float = _WEAR_SHARE
    wear_centre: float = _WEAR_CENTRE

    def __post_init__(self) -> None:
        worn_lobes = self.worn_lobes  # in the order of wear_um
        for name in ("worn_lobes", "removed_lobes"):
            given = getattr(self, name)
            lobes = list_members(given)
            if lobes is None or len({*lobes}) < len(lobes) or not all(is_whole(k) and k >= 0 for k in lobes):
                raise ValueError(f"{name} must be distinct whole numbers from 0, got {given!r}")
            object.__setattr__(self, name, tuple(sorted(int(lobe) for lobe in lobes)))
        wheels = sorted(list_members(self.wheels) or (), key=str)
        if wheels not in ([0], [1], [0, 1]):
            raise ValueError(f"wheels must be (0,), (1,) or (0, 1), got {self.wheels!r}")
        object.__setattr__(self, "wheels", tuple(map(int, wheels)))
        if not 0 <= number("depth", self.depth) <= 1:
            raise ValueError(f"depth must lie between 0 (healthy) and 1 (the chord), got {self.depth!r}")
        both = set(self.worn_lobes) & set(self.removed_lobes)
        if both:
            raise ValueError(f"worn_lobes and removed_lobes must not overlap, both hold {sorted(both)}")
        depths: Any = self.wear_um
        if depths is not None:
            values = (depths,) if is_number(depths) else list_members(depths)
            what = "a number of um, or one for each worn lobe"
            if values is None:
                raise TypeError(f"wear_um must be {what}, got {repr_of(depths)}")
            for value in values:
                if not 0 <= number("wear_um", value, what) <= MOST_WEAR_UM:
                    raise ValueError(f"wear_um must lie between 0 and {MOST_WEAR_UM:g} um, got {value!r}")
            if is_number(depths):
                wear_um: float | tuple[float, ...] = float(depths)
            elif len(values) != len(worn_lobes):
                got = f"{len(values)} values for {len(worn_lobes)} worn lobes"
                raise ValueError(f"wear_um must be {what}, got {got}")
            else:
                wear_um = tuple(float(value) for _, value in sorted(zip(worn_lobes, values, strict=True)))
            object.__setattr__(self, "wear_um", wear_um)
        share, centre = number("wear_share", self.wear_share), number("wear_centre", self.wear_centre)
        if self.wear_um is None:
            if (share, centre) != (_WEAR_SHARE, _WEAR_CENTRE):
                raise ValueError("wear_share and wear_centre have no effect without wear_um: give it too")
            return
        if self.depth != 0:
            raise ValueError(f"depth must be 0 with wear_um (radial wear), got {self.depth!r}")
        if not 0 < share <= 1:
            raise ValueError(f"wear_share must lie above 0 and up to 1, got {self.wear_share!r}")
        # A half share may be rounded past the flank's end.
        if not share / 2 - 1e-12 <= centre <= 1 - share / 2 + 1e-12:
            raise ValueError(
                f"wear_centre must lie between {share / 2:g} and {1 - share / 2:g}, so that a wear_share of "
                f"{share:g} lies on the flank, got {self.wear_centre!r}"
            )

    @classmethod
    def healthy(cls) -> LobeDefects:
        """Return a gearbox without defects.

        Returns
        -------
        LobeDefects
        """
        return cls()

    @classmethod
    def worn(
        cls,
        lobes: int | Iterable[int],
        *,
        wheels: Sequence[int] = (0, 1),
        depth: float | None = None,
        wear_um: float | Sequence[float] | None = None,
        wear_share: float = _WEAR_SHARE,
        wear_centre: float = _WEAR_CENTRE,
    ) -> LobeDefects:
        """Return worn lobes.

        Parameters
        ----------
        lobes : int or iterable of int
            Number of worn lobes (consecutive from lobe 0) or their indices.
        wheels, wear_share, wear_centre
            See :class:`LobeDefects`.
        depth : float, optional
            See :class:`LobeDefects`. Default: 1, the papers' chord, or 0 with ``wear_um``.
        wear_um : float or sequence of float, optional
            Radial wear in um, the same for all worn lobes or one for each in the order of ``lobes``.

        Returns
        -------
        LobeDefects

        Examples
        --------
        >>> LobeDefects.worn(3).worn_lobes
        (0, 1, 2)
        >>> LobeDefects.worn((0, 4), wheels=(0,)).defect_count
        2
        >>> LobeDefects.worn((4, 0), wear_um=(20, 50)).wear_um  # sorted with the lobes
        (50.0, 20.0)
        """
        if depth is None:
            depth = 1.0 if wear_um is None else 0.0
        return cls(
            worn_lobes=_lobe_indices(lobes), wheels=tuple(wheels), depth=depth,
            wear_um=wear_um, wear_share=wear_share, wear_centre=wear_centre,
        )  # fmt: skip

    @classmethod
    def pitted(
        cls,
        lobes: int | Iterable[int],
        *,
        wear_um: float | Sequence[float],
        length_mm: float = 2.0,
        wear_centre: float = _WEAR_CENTRE,
        wheels: Sequence[int] = (0, 1),
        gearbox: CycloidalGearbox | None = None,
    ) -> LobeDefects:
        """Return lobes with one pit each: radial wear over a short length of the flank.

        Parameters
        ----------
        lobes : int or iterable of int
            Number of pitted lobes (consecutive from lobe 0) or their indices.
        wear_um : float or sequence of float
            How far a pin sinks into the pit, in um. Into a short pit a pin does not reach far: runs of a
            gearbox with more than that raise an error that states the limit.
        length_mm : float, default 2
            Length of the pit along the profile, in mm.
        wear_centre : float, default 0.5
            Place of the pit on the flank, from 0 (tip of the lobe) to 1 (bottom between two lobes).
        wheels : sequence of int
            Wheels with the pits.
        gearbox : CycloidalGearbox, default ``CycloidalGearbox.steel()``
            Gearbox whose flank has the pits.

        Returns
        -------
        LobeDefects

        Raises
        ------
        TypeError, ValueError
            If a parameter is of the wrong type, or the pit is longer than the flank has room for.

        Examples
        --------
        >>> round(LobeDefects.pitted(1, wear_um=10, length_mm=2).wear_share, 3)
        0.223
        """
        gearbox, _ = check_machine(gearbox, None)
        length = 1e-3 * positive("length_mm", length_mm)
        centre = number("wear_centre", wear_centre)
        if not 0 < centre < 1:
            raise ValueError(f"wear_centre must lie between 0 (tip) and 1 (pit), got {wear_centre!r}")
        profile = gearbox.outline_profile
        widest = 2 * min(centre, 1 - centre)

        def excess(share: float) -> float:
            return profile.flank_length(centre - share / 2, centre + share / 2) - length

        if excess(widest) < 0:
            most = 1e3 * (excess(widest) + length)
            raise ValueError(f"length_mm must be at most {most:.3g} about wear_centre, got {length_mm!r}")
        share = brentq(excess, 0.0, widest)
        return cls.worn(lobes, wheels=wheels, wear_um=wear_um, wear_share=share, wear_centre=centre)

    @classmethod
    def removed(cls, lobes: int | Iterable[int], *, wheels: Sequence[int] = (0, 1)) -> LobeDefects:
        """Return removed lobes.

        Parameters
        ----------
        lobes : int or iterable of int
            Number of removed lobes (consecutive from lobe 0) or their indices.
        wheels : sequence of int, default (0, 1)
            Wheels without these lobes.

        Returns
        -------
        LobeDefects
        """
        return cls(removed_lobes=_lobe_indices(lobes), wheels=tuple(wheels))

    @property
    def defect_count(self) -> int:
        """Number of distinct defective lobe indices."""
        return len(self.worn_lobes) + len(self.removed_lobes)


def check_machine(
    gearbox: CycloidalGearbox | None, defects: LobeDefects | None
) -> tuple[CycloidalGearbox, LobeDefects]:
    """Return the checked gearbox and defects; defaults: steel, healthy."""
    gearbox = CycloidalGearbox.steel() if gearbox is None else gearbox
    defects = LobeDefects.healthy() if defects is None else defects
    check_type("gearbox", gearbox, CycloidalGearbox)
    check_type("defects", defects, LobeDefects)
    highest, n_lobes = max(defects.worn_lobes + defects.removed_lobes, default=-1), gearbox.n_lobes
    if highest >= n_lobes:
        raise ValueError(f"defects name lobe {highest} (from 0), but the wheel has {n_lobes} lobes")
    if defects.wear_um is None or not defects.worn_lobes:
        return gearbox, defects
    deepest = np.max(defects.wear_um)
    most = 1e6 * gearbox.outline_profile.deepest_wear(defects.wear_share, defects.wear_centre)
    if deepest > most:
        raise ValueError(
            f"wear_um must be at most {most:.3g} with wear_share={defects.wear_share:.3g} and wear_centre="
            f"{defects.wear_centre:.3g}: a pin reaches no deeper into wear so short, got {deepest:g}"
        )
    return gearbox, defects


def _lobe_indices(lobes: Any) -> tuple[int, ...]:
    if is_whole(lobes) and lobes >= 0:
        return tuple(range(lobes))
    given = list_members(lobes)
    if given is None:
        raise ValueError(f"lobes must be a number of lobes from 0, or their indices, got {lobes!r}")
    return given
