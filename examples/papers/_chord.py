"""Gearbox model whose worn lobe switches surfaces at the chord's end, for the finding on the chord.

It has three angles (wheels about their centres of mass, output about the origin), the midpoint rule and paper
B's contact law; points of the plane are complex numbers. It is wrong in this one place on purpose and equals
the simulator elsewhere.
"""

from __future__ import annotations

import math

import numpy as np
from _papers import STEEL, Float
from numba import njit

from cyclofeat.simulators import LobeDefects, Solver, simulate
from cyclofeat.simulators.tables import contact_constants

SPEED, LOAD = STEEL.input_speed, STEEL.load_torque
LOBE_PERIOD_S = 2 * math.pi / SPEED * 15 / 16
SETTLING_S = 0.1
E, Q, Z = STEEL.eccentricity, STEEL.pin_radius, STEEL.n_pins
RING, PITCH = STEEL.pin_circle_radius, 2 * math.pi / STEEL.n_lobes
TIP, PIT = STEEL.profile.chord()
CHORD_NORMAL = -1j * (PIT - TIP) / abs(PIT - TIP)
R_TIP = float(STEEL.profile.effective_radius(0.0))
HERTZ = contact_constants(STEEL, STEEL.pin_radius).stiffness_factor  # N / m^2: K over the root of the radius
C, RAMP = STEEL.contact_damping, STEEL.contact_ramp
R_IN, Q_IN = STEEL.internal_pitch_radius, STEEL.internal_sleeve_radius
R_HOLE = Q_IN * (Q_IN + E) / E
J_WHEEL, J_OUT = STEEL.wheel_inertia, STEEL.output_inertia


@njit
def _force(depth, closing, radius):
    rise = min(depth / RAMP, 1.0)
    return max(rise * (HERTZ * math.sqrt(radius) * depth**1.5 + C * closing), 0.0) if depth > 0 else 0.0


@njit
def _pin_force(p, rate, t, worn):
    """Return the force (complex, N, wheel's frame) of a pin at ``p`` whose foot is near parameter ``t``."""
    angle = math.atan2(p.imag, p.real) % (2 * math.pi)
    lobe = int(angle / PITCH)
    if lobe < worn and angle - lobe * PITCH < PITCH / 2:
        turn = complex(math.cos(lobe * PITCH), math.sin(lobe * PITCH))
        from_tip = p / turn - TIP
        normal = CHORD_NORMAL
        if (from_tip * (1j * CHORD_NORMAL).conjugate()).real < 0:  # still on the vertex at the tip
            normal = from_tip / abs(from_tip)
        gap = (from_tip * normal.conjugate()).real - Q
        radius = R_TIP + (Q - R_TIP) * normal.imag / CHORD_NORMAL.imag
        normal *= turn
    else:  # switch to the healthy flank at once: this is the intended mistake
        for _ in range(5):
            ring, wave = RING * np.exp(1j * t), E * np.exp(1j * Z * t)
            tangent, bend = 1j * (ring + Z * wave), -(ring + Z * Z * wave)
            offset = p - ring - wave
            t += (offset * tangent.conjugate()).real / (abs(tangent) ** 2 - (offset * bend.conjugate()).real)
        ring, wave = RING * np.exp(1j * t), E * np.exp(1j * Z * t)
        tangent, bend = 1j * (ring + Z * wave), -(ring + Z * Z * wave)
        normal = -1j * tangent / abs(tangent)
        gap = ((p - ring - wave) * normal.conjugate()).real
        radius = Q * (1 - Q * (tangent.conjugate() * bend).imag / abs(tangent) ** 3)
    return -_force(-gap, -(rate * normal.conjugate()).real, radius) * normal


@njit
def _slope(time, y, worn):
    """Return the derivative of the wheels' and output's angles and speeds, and the output torque in Nm."""
    phi = SPEED * time - math.pi
    found = np.zeros(7)
    found[:3] = y[3:6]
    for k in range(2):
        cam = E * np.exp(1j * (phi + k * math.pi))
        turn = np.exp(1j * y[k])
        for j in range(Z):
            arm = RING * np.exp(2j * math.pi * j / Z) - cam
            rate = -1j * SPEED * cam - 1j * y[3 + k] * arm
            force = _pin_force(arm / turn, rate / turn, 2 * math.pi * j / Z - y[k], worn) * turn
            found[3 + k] += (arm.conjugate() * force).imag / J_WHEEL
        for j in range(8):
            # Both lie on the same ray at rest: lobe 0 of wheel k points to pi k at the input angle -pi.
            sleeve = R_IN * np.exp(1j * (y[2] + math.pi / 4 * j))
            hole = R_IN * turn * np.exp(1j * (math.pi / 4 * j + math.pi / 15 - math.pi * k))
            away = sleeve - cam - hole
            rate = 1j * y[5] * sleeve - 1j * SPEED * cam - 1j * y[3 + k] * hole
            normal = away / abs(away)
            force = _force(abs(away) - E, (rate * normal.conjugate()).real, R_HOLE) * normal
            found[3 + k] += ((sleeve - cam).conjugate() * force).imag / J_WHEEL
            found[6] += (sleeve.conjugate() * force).imag
    found[5] = (LOAD - found[6]) / J_OUT
    return found


@njit
def _torque(dt, n_steps, worn):
    y = np.zeros(6)
    y[1], y[2] = math.pi, math.pi / 15
    y[:3] += np.array([1.7e-3, 1.7e-3, 4.1e-3])  # approximate deflections under load
    y[3:] = -SPEED / 15
    torque = np.empty(n_steps)
    for step in range(n_steps):
        change = _slope(step * dt, y, worn)
        torque[step] = change[6]
        y += dt * _slope((step + 0.5) * dt, y + dt / 2 * change[:6], worn)[:6]
    return torque


def switched_torque(worn: int = 1, dt: float = 1e-5) -> Float:
    """Output torque in Nm over one lobe period with the switched surface, speed and load constant."""
    n = round(LOBE_PERIOD_S / dt)
    return np.asarray(_torque(dt, round(SETTLING_S / dt) + n, worn)[-n:])


def closed_torque(worn: int = 1, dt: float = 1e-5) -> Float:
    """Return the same for the closed outline, from the simulator, at the same angles of the input."""
    run = simulate(
        STEEL.replace(ramp_time=0.0), LobeDefects.worn(worn), duration=SETTLING_S + LOBE_PERIOD_S,
        sampling_rate=1 / dt, solver=Solver(decimation="pick"),
        start_angle=-math.pi, motion=False,
    )  # fmt: skip
    return run.torque_out[-round(LOBE_PERIOD_S / dt) :]


def pressed_in(degrees: Float) -> tuple[Float, Float]:
    """Penetration in m of a sleeve that moves along the healthy flank of a worn lobe: closed, switched."""
    path = STEEL.profile.trochoid(np.deg2rad(degrees))
    chord = np.maximum(Q - ((path - TIP) * CHORD_NORMAL.conjugate()).real, 0)
    return chord, np.where(degrees < 12, chord, 0.0)
