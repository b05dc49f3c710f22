"""Closed-form geometry of the cycloidal drive: profile, curvature, worn and removed lobes.

A wheel's profile is the parallel curve of a shortened trochoid, one pin radius inside: the contact gap is the
signed distance of the pin's centre from the trochoid. Points are complex numbers in the frame of the wheel,
whose centre is the origin; the tip of lobe 0 lies on the real axis. SI units and radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Complex = NDArray[np.complex128]
Float = NDArray[np.float64]


@dataclass(frozen=True)
class CycloidalProfile:
    """Profile of a cycloidal wheel (paper A eq. 1, paper B eq. 1).

    Parameters
    ----------
    eccentricity : float
        Eccentricity e of the cams in m.
    n_pins : int
        Number of pins (external sleeves) z_k; the wheel has ``n_pins - 1`` lobes (z_s).
    shortening : float
        Short-width coefficient m, between 0 and 1; the pins sit on a circle of radius e z_k / m.
    pin_radius : float
        Radius q of a pin in m.

    Examples
    --------
    >>> profile = CycloidalProfile(2.8e-3, 16, 0.7, 6e-3)
    >>> round(float(abs(profile.point(0.0))) * 1e3, 3)  # tip of a lobe, mm
    60.8
    """

    eccentricity: float
    n_pins: int
    shortening: float
    pin_radius: float

    @property
    def n_lobes(self) -> int:
        """Number of lobes z_s."""
        return self.n_pins - 1

    @property
    def pin_circle_radius(self) -> float:
        """Radius R = e z_k / m of the circle on which the pins sit, in m."""
        return self.eccentricity * self.n_pins / self.shortening

    @property
    def lobe_pitch(self) -> float:
        """Angle from one lobe to the next, in rad of the profile parameter."""
        return 2 * np.pi / self.n_lobes

    def trochoid(self, t: ArrayLike) -> Complex:
        """Path T(t) = R exp(it) + e exp(i z_k t) of a pin's centre, in m."""
        t = np.asarray(t, dtype=float)
        path = self.pin_circle_radius * np.exp(1j * t) + self.eccentricity * np.exp(1j * self.n_pins * t)
        return np.asarray(path, dtype=complex)

    def _tangent_factor(self, t: ArrayLike) -> Complex:
        """Factor g(t) = 1/m + exp(i z_s t) of the tangent T' = i e z_k exp(it) g."""
        turned = np.exp(1j * self.n_lobes * np.asarray(t, dtype=float))
        return np.asarray(1 / self.shortening + turned, dtype=complex)

    def normal(self, t: ArrayLike) -> Complex:
        """Outward unit normal of trochoid and profile at parameter t."""
        g = self._tangent_factor(t)
        return np.asarray(np.exp(1j * np.asarray(t, dtype=float)) * g / np.abs(g), dtype=complex)

    def point(self, t: ArrayLike) -> Complex:
        """Point of the wheel's profile at parameter t, in m."""
        return self.trochoid(t) - self.pin_radius * self.normal(t)

    def curvature(self, t: ArrayLike) -> Float:
        """Signed curvature of the trochoid in 1/m, positive where the profile is convex."""
        g2 = np.abs(self._tangent_factor(t)) ** 2
        cos_lobe = np.cos(self.n_lobes * np.asarray(t, dtype=float))
        return np.asarray(
            (1 + self.n_lobes * (1 + cos_lobe / self.shortening) / g2)
            / (self.eccentricity * self.n_pins * np.sqrt(g2))
        )

    def effective_radius(self, t: ArrayLike, clearance: float = 0.0) -> Float:
        """Effective contact radius q (1 - kappa q) of pin and profile in m (paper B eq. 14).

        It equals ``1 / (1/R_c + 1/q)`` with the radius R_c = 1/kappa - q - c of the profile, negative where
        concave, and the ``clearance`` c of the pins in m.
        """
        kappa, q = self.curvature(t), self.pin_radius
        return np.asarray(q * (1 - kappa * (q + clearance)) / (1 - kappa * clearance))

    def _path_speed(self, t: ArrayLike) -> Float:
        """Length |T'| of the trochoid per parameter at t, in m/rad."""
        return np.asarray(self.eccentricity * self.n_pins * np.abs(self._tangent_factor(t)))

    def flank_length(self, first: float = 0.0, last: float = 1.0) -> float:
        """Length of the profile between two places of a flank, from 0 (tip) to 1 (pit), in m.

        Examples
        --------
        >>> profile = CycloidalProfile(2.8e-3, 16, 0.7, 6e-3)
        >>> round(profile.flank_length() * 1e3, 2)
        13.85
        """
        t = np.linspace(first, last, 1001) * np.pi / self.n_lobes
        return float(np.trapezoid(self._path_speed(t) * (1 - self.curvature(t) * self.pin_radius), t))

    def deepest_wear(self, share: float, centre: float) -> float:
        """Return the largest radial wear that a pin can follow, in m.

        Where the pins' path over the worn flank would be curved more tightly than a pin, the pin would rest
        on an edge instead of following it (to first order in the wear).

        Parameters
        ----------
        share, centre : float
            As ``wear_share`` and ``wear_centre`` of :class:`cyclofeat.simulators.LobeDefects`.
        """
        x = np.linspace(0, 1, 1001)
        flank = np.pi / self.n_lobes
        t = (centre + share * (x - 0.5)) * flank
        rate = 2 * np.pi / (share * flank)
        speed = self._path_speed(t)
        growth = np.gradient(np.log(speed), t)
        # Curvature that wear of 1 m adds: w'' along the path.
        sine, cosine = np.sin(2 * np.pi * x), np.cos(2 * np.pi * x)
        raised = (1 - cosine) / 2
        added = rate * (rate * (sine**2 / 2 + raised * cosine) - growth * raised * sine) / speed**2
        left = 1 / self.pin_radius - self.curvature(t)
        return float(np.min(left[added > 0] / added[added > 0]))

    def chord(self) -> tuple[complex, complex]:
        """End points (tip, pit) of the chord that replaces the worn half of lobe 0, in m."""
        return complex(self.point(0.0)), complex(self.point(np.pi / self.n_lobes))

    def outline(self, worn: tuple[int, ...] = (), points_per_lobe: int = 200) -> Complex:
        """Closed outline of the wheel with the chord at each worn lobe, for drawing.

        Parameters
        ----------
        worn : tuple of int
            Worn lobes, counted from 0.
        points_per_lobe : int
            Even number of points on each lobe.

        Returns
        -------
        ndarray of complex, shape (n_lobes * points_per_lobe,)
        """
        t = np.arange(self.n_lobes * points_per_lobe) * self.lobe_pitch / points_per_lobe
        outline = self.point(t)
        tip, pit = self.chord()
        share = np.arange(points_per_lobe // 2) / (points_per_lobe // 2)
        for lobe in worn:
            first = lobe * points_per_lobe
            turn = np.exp(1j * lobe * self.lobe_pitch)
            outline[first : first + points_per_lobe // 2] = turn * (tip + share * (pit - tip))
        return outline
