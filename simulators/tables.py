"""Constants and tables of one gearbox with its defects, as the compiled kernel takes them.

Parameters of contacts by material and geometry: paper B eq. 12-16.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat.simulators import _kernels, _outline
from cyclofeat.simulators.defects import LobeDefects
from cyclofeat.simulators.gearbox import CONTACT_LAWS, CycloidalGearbox

Float = NDArray[np.float64]


class KernelInput(NamedTuple):
    """Constants and tables of one gearbox with its defects, in the order of the kernel's arguments."""

    wheel: _outline.WheelConstants
    joint: _kernels.JointConstants
    contact: _kernels.ContactConstants
    joint_contact: _kernels.ContactConstants
    body: _kernels.BodyConstants
    friction: _kernels.FrictionConstants | None
    pins: Float
    mounts: Float
    lobes: Float
    wear: Float
    sleeves: Float


def kernel_input(gearbox: CycloidalGearbox, defects: LobeDefects) -> KernelInput:
    """Translate parameters into the kernel's constants and tables."""
    n_lobes = gearbox.n_lobes
    wear, radial = np.zeros((2, 2, n_lobes))
    for w in defects.wheels:
        wear[w, list(defects.worn_lobes)] = defects.depth
        wear[w, list(defects.removed_lobes)] = _outline.REMOVED
        radial[w, list(defects.worn_lobes)] = 1e-6 * np.asarray(defects.wear_um or 0.0)
    lobe_angles, pin_angles, sleeve_angles = (
        2 * np.pi * np.arange(n) / n for n in (n_lobes, gearbox.n_pins, gearbox.n_internal_sleeves)
    )
    pitch_errors = np.reshape(gearbox.lobe_pitch_errors or np.zeros(2 * n_lobes), (2, n_lobes))
    # The wheels are mounted as close to 180 deg apart as their lobes allow (exactly, if z_s is odd).
    rest = np.array([-math.pi / n_lobes, 2 * math.pi * ((n_lobes + 1) // 2 - 1) / n_lobes])
    runouts = np.asarray(gearbox.wheel_runouts or (0j, 0j), dtype=complex)
    cams = gearbox.eccentricity * np.array([1, -1]) + np.asarray(gearbox.cam_errors or (0j, 0j))
    mounts = [rest, np.cos(rest), np.sin(rest), runouts.real, runouts.imag, cams.real, cams.imag]
    return KernelInput(
        wheel=_wheel_constants(gearbox, defects),
        joint=_kernels.JointConstants(
            gearbox.n_internal_sleeves, float(gearbox.internal_pitch_radius),
            float(gearbox.internal_sleeve_radius), float(gearbox.eccentricity + gearbox.clearance),
        ),
        # The conservative law uses the radius of the pin for every pin contact, as on a plane flank.
        contact=contact_constants(gearbox, gearbox.pin_radius),
        joint_contact=contact_constants(gearbox, joint_effective_radius(gearbox)),
        body=_constants(_kernels.BodyConstants, gearbox),
        friction=None
        if not gearbox.has_friction
        else _constants(
            _kernels.FrictionConstants, gearbox,
            sleeve_static_friction=float(gearbox.sleeve_static_friction or gearbox.sleeve_friction),
        ),
        pins=_table_of_rows(
            np.cos(pin_angles), np.sin(pin_angles), gearbox.pin_radial_errors,
            gearbox.pin_tangential_errors, pin_angles,
        ),
        mounts=_table_of_rows(*np.column_stack([*mounts, (wear > 0).any(axis=1)])),
        lobes=_table_of_rows(
            np.cos(lobe_angles), np.sin(lobe_angles), *pitch_errors / gearbox.pin_circle_radius
        ),
        wear=_table_of_rows(*wear, *radial),
        sleeves=_table_of_rows(np.cos(sleeve_angles), np.sin(sleeve_angles)),
    )  # fmt: skip


def _constants(kind: Any, gearbox: CycloidalGearbox, **others: Any) -> Any:
    """Return the constants of a kind: fields of the gearbox with the same names, and ``others``."""
    same = {name: float(getattr(gearbox, name)) for name in kind._fields if name not in others}
    return kind(**same, **others)


def _table_of_rows(*rows: ArrayLike) -> Float:
    """Return rows, in the order of the kernel's indices, as one flat table of rows of COLUMNS numbers."""
    table = np.zeros((len(rows), _outline.COLUMNS))
    for row, values in zip(table, rows, strict=True):
        row[: np.size(values)] = values
    return table.ravel()


def _wheel_constants(gearbox: CycloidalGearbox, defects: LobeDefects) -> Any:
    profile = gearbox.outline_profile
    tip, pit = profile.chord()
    pit_angle = math.pi / gearbox.n_lobes
    pit_normal = complex(profile.normal(pit_angle))
    pin_errors = np.hypot(gearbox.pin_radial_errors or [0.0], gearbox.pin_tangential_errors or [0.0])
    return _constants(
        _outline.WheelConstants, gearbox, n_lobes=int(gearbox.n_lobes),
        clearance=float(gearbox.pin_clearance), tip_x=tip.real, pit_x=pit.real, pit_y=pit.imag,
        pit_nx=pit_normal.real, pit_ny=pit_normal.imag,
        tip_radius=float(gearbox.profile.effective_radius(0.0, gearbox.pin_clearance)),
        pit_radius=float(gearbox.profile.effective_radius(pit_angle, gearbox.pin_clearance)),
        near=max(0.7 / abs(float(profile.curvature(pit_angle))) - float(pin_errors.max()), 0.0),
        has_pitch_errors=any(gearbox.lobe_pitch_errors), profile_points=gearbox.profile_points,
        # A flank is half a pitch.
        wear_first=0.5 * (defects.wear_centre - 0.5 * defects.wear_share),
        wear_width=0.5 * defects.wear_share,
    )  # fmt: skip


def rest_state(gearbox: CycloidalGearbox) -> Float:
    """Return the kernel's state at the rest position, with nothing in motion."""
    n_spins = gearbox.n_pins + gearbox.n_internal_sleeves if gearbox.has_friction else 0
    return np.zeros(_kernels.N_STATE + n_spins)


def stiffness_factor(gearbox: CycloidalGearbox) -> float:
    """Contact stiffness over the root of the effective radius, in N/m^2.

    K = 4 H / (3 pi (h_c + h_p)) sqrt(R), h = (1 - nu^2) / (pi E) (paper B eq. 14-16).
    """
    wheel = (1 - gearbox.wheel_poisson_ratio**2) / (math.pi * gearbox.wheel_youngs_modulus)
    sleeve = (1 - gearbox.sleeve_poisson_ratio**2) / (math.pi * gearbox.sleeve_youngs_modulus)
    return 4 * gearbox.stiffness_scale / (3 * math.pi * (wheel + sleeve))


def joint_effective_radius(gearbox: CycloidalGearbox) -> float:
    """Effective radius r_s r_h / (r_h - r_s) of an internal sleeve in its hole, in m."""
    sleeve = gearbox.internal_sleeve_radius
    difference = gearbox.eccentricity + gearbox.clearance
    return sleeve * (sleeve + difference) / difference


def pin_centres(gearbox: CycloidalGearbox) -> NDArray[np.complex128]:
    """Positions x + iy of the external sleeves' axles, with their errors, in m: shape (n_pins,)."""
    angles = 2 * np.pi * np.arange(gearbox.n_pins) / gearbox.n_pins
    radial, tangential = gearbox.pin_radial_errors or 0.0, gearbox.pin_tangential_errors or 0.0
    errors = np.asarray(radial) + 1j * np.asarray(tangential)
    return np.asarray((gearbox.pin_circle_radius + errors) * np.exp(1j * angles))


def sleeve_centres(gearbox: CycloidalGearbox, output_angle: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Positions x + iy of the internal sleeves' axles in m, at angles (n,) of the output: (n, n_sleeves)."""
    angles = 2 * np.pi * np.arange(gearbox.n_internal_sleeves) / gearbox.n_internal_sleeves
    return np.asarray(gearbox.internal_pitch_radius * np.exp(1j * (angles + output_angle[:, np.newaxis])))


def contact_constants(gearbox: CycloidalGearbox, constant_radius: float) -> _kernels.ContactConstants:
    """Constants of one kind of contact; ``constant_radius`` (m) is that of the conservative law."""
    return _kernels.ContactConstants(
        law=CONTACT_LAWS.index(gearbox.contact_law), stiffness_factor=stiffness_factor(gearbox),
        damping=float(gearbox.contact_damping), inverse_ramp=1 / gearbox.contact_ramp,
        constant_radius=float(constant_radius),
    )  # fmt: skip
