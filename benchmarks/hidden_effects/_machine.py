"""Independent implementation of the gearbox on its rig in numba, for recordings with hidden effects.

The physics and the contact law are those of :mod:`cyclofeat.simulators`, the code is separate: third-order
Adams-Bashforth at 102.4 kHz instead of the midpoint rule at 100 kHz, every pin's foot by one Newton step from
its position at rest, at every time step, and no stored lists of contacts.

All angles are deviations from a rotation at -phi/15. Complex numbers are written as two reals,
cross(a, b) = a_x b_y - a_y b_x. A pin is described in its own frame (radial, tangential), a worn lobe in the
lobe's frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import resample_poly

from cyclofeat.simulators import CycloidalGearbox

Float = NDArray[np.float64]

SAMPLING_RATE = 25_600.0
OVERSAMPLING = 4
STEP = 1 / (OVERSAMPLING * SAMPLING_RATE)
MARGIN = 16  # samples of the record that the anti-alias filter needs beyond its end
ABSURD = 1e4  # Nm

# The machine's constants, by index in one array.
(
    Z, ECC, INV_M, Q, RING, R_IN, GAP_IN, RAD_IN, J_WHEEL, J_OUT, K_HERTZ, DAMPING, RAMP, HUNT_CROSSLEY,
    TIP_X, PIT_X, PIT_Y, RAD_TIP, RAD_PIT, MU, SLIP_SPEED, Q_IN, J_SLEEVE,
    BEARING, BEARING_SPEED, J_ROTOR, K_METER, C_METER, J_SECOND, K_SECOND, C_SECOND,
    HAS_PITCH, N_NUMBERS,
) = range(33)  # fmt: skip
# State: angles of wheels, output, rotor, second rotor; their rates; spins of 16 + 8 sleeves.
OUT, ROTOR, SECOND, N_ANGLES = 2, 3, 4, 5
N_PINS, N_IN = 16, 8
N_STATE = 2 * N_ANGLES + N_PINS + N_IN
PITCH = 2 * math.pi / 15


@dataclass(frozen=True)
class Machine:
    """One assembly, the input of :func:`run`.

    Lengths in m, torques in Nm. ``pins`` is complex (radial + i tangential errors), ``cams`` and ``runouts``
    are complex by wheel, ``pitch`` holds the lobes' errors in rad, ``worn`` 0 or 1, both (2, 15).
    """

    speed: float = 500 / 60 * 2 * math.pi  # rad/s
    load: float = 22.0
    worn: NDArray[np.int64] = field(default_factory=lambda: np.zeros((2, 15), dtype=np.int64))
    pins: Any = field(default_factory=lambda: np.zeros(16, dtype=complex))
    cams: Any = field(default_factory=lambda: np.zeros(2, dtype=complex))
    runouts: Any = field(default_factory=lambda: np.zeros(2, dtype=complex))
    pitch: Float = field(default_factory=lambda: np.zeros((2, 15)))
    clearance: float = 0.0
    stiffness: float = 1.0  # factors on the contacts
    damping: float = 1.0
    hunt_crossley: bool = False
    sleeve_friction: float = 0.0
    bearing: float = 0.0
    rotor: tuple[float, float, float] = (0.0, 0.0, 0.0)  # inertia, stiffness, share of critical damping
    second_rotor: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def with_(self, **changes: Any) -> Machine:
        """Return a copy with changed fields."""
        return replace(self, **changes)

    def numbers(self) -> Float:
        """Return the constants that :func:`_integrate` takes."""
        g = CycloidalGearbox.steel()
        p = np.zeros(N_NUMBERS)
        q, e, z, m = g.pin_radius, g.eccentricity, g.n_pins - 1, g.shortening
        ring = e * (z + 1) / m
        materials = (
            (1 - g.wheel_poisson_ratio**2) / g.wheel_youngs_modulus
            + (1 - g.sleeve_poisson_ratio**2) / g.sleeve_youngs_modulus
        ) / math.pi
        play_in = e + self.clearance
        # Curvature of the trochoid at tip and pit: |g| = 1/m + 1 and 1/m - 1.
        bend_tip = (1 + z * (1 + 1 / m) / (1 / m + 1) ** 2) / (e * (z + 1) * (1 / m + 1))
        bend_pit = (1 + z * (1 - 1 / m) / (1 / m - 1) ** 2) / (e * (z + 1) * (1 / m - 1))
        deep = ring - e - q  # the pit's distance from the centre
        damping = g.contact_damping
        if self.hunt_crossley:
            # The loss in small torsional vibration of the loaded half of the ring about the mean load is
            # equal.
            arm = e * z * np.sin(np.pi * (np.arange(8) + 0.5) / 8)
            share = 11.0 * arm**1.5 / np.sum(arm**2.5)
            damping *= np.sum(arm**2) / np.sum(share * arm**2)
        values = {
            Z: z, ECC: e, INV_M: 1 / m, Q: q, RING: ring, R_IN: g.internal_pitch_radius, GAP_IN: play_in,
            RAD_IN: g.internal_sleeve_radius * (g.internal_sleeve_radius + play_in) / play_in,
            J_WHEEL: g.wheel_inertia,
            J_OUT: g.output_shaft_inertia + 8 * g.internal_sleeve_mass * g.internal_pitch_radius**2,
            K_HERTZ: 4 * g.stiffness_scale * self.stiffness / (3 * math.pi * materials),
            DAMPING: damping * self.damping, RAMP: g.contact_ramp, HUNT_CROSSLEY: float(self.hunt_crossley),
            TIP_X: ring + e - q, PIT_X: deep * math.cos(PITCH / 2), PIT_Y: deep * math.sin(PITCH / 2),
            RAD_TIP: q * (1 - q * bend_tip), RAD_PIT: q * (1 - q * bend_pit),
            MU: self.sleeve_friction, SLIP_SPEED: g.friction_transition_speed, Q_IN: g.internal_sleeve_radius,
            J_SLEEVE: g.sleeve_inertia, BEARING: self.bearing, BEARING_SPEED: g.bearing_transition_speed,
            J_ROTOR: self.rotor[0], K_METER: self.rotor[1],
            C_METER: 2 * self.rotor[2] * math.sqrt(self.rotor[0] * self.rotor[1]),
            J_SECOND: self.second_rotor[0], K_SECOND: self.second_rotor[1],
            C_SECOND: 2 * self.second_rotor[2] * math.sqrt(self.second_rotor[0] * self.second_rotor[1]),
            HAS_PITCH: float(np.any(self.pitch)),
        }  # fmt: skip
        for place, value in values.items():
            p[place] = value
        return p


# Rows of sixteen in one flat array: the compiler then sees that they do not overlap and uses vector
# instructions. Constants of the pins and sleeves first, then what an evaluation writes.
(
    CB, SB, ERR_R, ERR_T, CA, SA, LEVER_X, LEVER_Y, RUN_X, RUN_Y, PLACE, TURNED, SLOPE, WEIGHT, EDGE_X,
    EDGE_Y, FLANK_X, FLANK_Y, MOMENT, HOLE_F, HOLE_X, HOLE_Y, ON_OUT, ON_CAM, N_ROWS,
) = (np.uintp(16 * row) for row in range(25))  # fmt: skip


@njit(nogil=True, cache=True, error_model="numpy", inline="always")
def _small(x):
    """Sine and cosine of a small angle, to rounding below 0.1 rad."""
    y = x * x
    sine = x * (1.0 - y / 6.0 * (1.0 - y / 20.0 * (1.0 - y / 42.0 * (1.0 - y / 72.0))))
    cosine = 1.0 - y / 2.0 * (1.0 - y / 12.0 * (1.0 - y / 30.0 * (1.0 - y / 56.0 * (1.0 - y / 90.0))))
    return sine, cosine


@njit(nogil=True, cache=True, error_model="numpy")
def _edges(w, theta, cx, cy, ct, st, omega, rate, p, t, worn, pitch, lobes):
    """Contacts of one wheel with the chords of worn lobes; returns their moments about the cam and on it.

    It also sets each pin's weight of the flank, which is zero on the worn half.
    """
    q = p[Q]
    tip = p[TIP_X]
    ox = p[PIT_Y]
    oy = tip - p[PIT_X]
    length = math.sqrt(ox * ox + oy * oy)
    ox /= length
    oy /= length
    first = -theta / PITCH
    per_pin = 2.0 * math.pi / N_PINS / PITCH
    for j in range(np.uintp(N_PINS)):
        # The pin from the profile's own centre, in the pin's frame, and its polar angle on the wheel.
        s = (t[LEVER_Y + j] - t[RUN_Y + j]) / (t[LEVER_X + j] - t[RUN_X + j])
        angle = s * (1.0 - s * s * (1.0 / 3.0 - 0.2 * s * s)) - t[TURNED + j]
        t[PLACE + j] = first + j * per_pin + angle / PITCH
    moment = 0.0
    on_input = 0.0
    for j in range(np.uintp(N_PINS)):
        whole = math.floor(t[PLACE + j])
        part = t[PLACE + j] - whole
        lobe = int(whole) % 15
        if part < 0.5:
            t[WEIGHT + j] = 1.0 - worn[w, lobe]
        # Ahead of the tip a pin is on the previous flank; far beyond the pit it has left the chord.
        if worn[w, lobe] == 0 or part > 0.75:
            continue
        x = t[LEVER_X + j] - t[RUN_X + j]
        y = t[LEVER_Y + j] - t[RUN_Y + j]
        # From the pin's frame to the lobe's: rotate by the pin's position on the wheel, then back by the
        # lobe's.
        cb = t[CB + j]
        sb = t[SB + j]
        ax = cb * ct + sb * st
        ay = sb * ct - cb * st
        cl = lobes[0, lobe] - pitch[w, lobe] * lobes[1, lobe]
        sl = lobes[1, lobe] + pitch[w, lobe] * lobes[0, lobe]
        cr = ax * cl + ay * sl
        sr = ay * cl - ax * sl
        px = cr * x - sr * y
        py = sr * x + cr * y
        lx = cr * t[LEVER_X + j] - sr * t[LEVER_Y + j]
        ly = sr * t[LEVER_X + j] + cr * t[LEVER_Y + j]
        gx = cb * cx + sb * cy
        gy = cb * cy - sb * cx
        kx = cr * gx - sr * gy
        ky = sr * gx + cr * gy
        for kind in range(2):
            if kind == 0:
                v = (px - tip) * ox + py * oy
                u = py * ox - (px - tip) * oy
                b = u if u < 0.0 else 0.0
                distance = math.sqrt(v * v + b * b)
                if distance >= q:
                    continue
                # At the tip the effective radius changes from the profile's to that of a plane.
                share = min(max((v + ox / oy * b) / distance, 0.0), 1.0)
                radius = p[RAD_TIP] + share * (q - p[RAD_TIP])
                nx = (v * ox - b * oy) / distance
                ny = (v * oy + b * ox) / distance
            else:
                if part >= 0.5:
                    continue
                wx = px - p[PIT_X]
                wy = py - p[PIT_Y]
                distance = math.sqrt(wx * wx + wy * wy)
                if distance >= q:
                    continue
                radius = p[RAD_PIT]
                nx = wx / distance
                ny = wy / distance
            on_cam = kx * ny - ky * nx
            on_wheel = lx * ny - ly * nx
            d = q - distance
            rise = min(d / p[RAMP], 1.0)
            elastic = p[K_HERTZ] * rise * d * math.sqrt(radius * d)
            damped = elastic if p[HUNT_CROSSLEY] > 0.0 else rise
            f = max(elastic + p[DAMPING] * damped * (omega * on_cam + rate * on_wheel), 0.0)
            moment -= f * on_wheel
            on_input += f * on_cam
            t[EDGE_X + j] -= f * (cr * nx + sr * ny)
            t[EDGE_Y + j] -= f * (cr * ny - sr * nx)
    return moment, on_input


@njit(nogil=True, cache=True, error_model="numpy")
def _pitch_errors(w, theta, t, pitch):
    """Displacement of the profile at each pin, in rad, and its slope by the profile's parameter."""
    for j in range(np.uintp(N_PINS)):
        place = (j * (2.0 * math.pi / N_PINS) - theta) / PITCH
        whole = math.floor(place)
        lobe = int(whole) % 15
        part = place - whole
        here = pitch[w, lobe]
        t[TURNED + j] = here
        t[SLOPE + j] = 0.0
        if part >= 0.5:
            change = pitch[w, (lobe + 1) % 15] - here
            x = 2.0 * part - 1.0
            t[TURNED + j] += change * x * x * (3.0 - 2.0 * x)
            t[SLOPE + j] = change * 12.0 * x * (1.0 - x) / PITCH


@njit(nogil=True, cache=True, error_model="numpy")
def _flanks(dx, dy, cx, cy, ct, st, cl, sl, omega, rate, p, t):
    """Contacts of one wheel with the smooth profile; returns their moments about the cam and on it."""
    q = p[Q]
    z = p[Z]
    inv_m = p[INV_M]
    ez = p[ECC] * (z + 1.0)
    inv_ez = 1.0 / ez
    a1 = (1.0 + 0.5 * z) * inv_ez
    a3 = 0.5 * z * (1.0 - inv_m * inv_m) * inv_ez
    steep = z * inv_m * inv_ez
    ecc = p[ECC]
    p_ring = p[RING]
    hertz = p[K_HERTZ]
    per_ramp = 1.0 / p[RAMP]
    plain = 0.0 if p[HUNT_CROSSLEY] > 0.0 else p[DAMPING]
    weighted = p[DAMPING] if p[HUNT_CROSSLEY] > 0.0 else 0.0
    for j in range(np.uintp(N_PINS)):
        cb = t[CB + j]
        sb = t[SB + j]
        ax = cb * ct + sb * st
        ay = sb * ct - cb * st
        lx = cb * cl + sb * sl
        ly = cb * sl - sb * cl
        gx = inv_m + lx
        i2 = 1.0 / (gx * gx + ly * ly)
        ig = math.sqrt(i2)
        lever_x = t[LEVER_X + j]
        lever_y = t[LEVER_Y + j]
        turned = t[TURNED + j]
        # Pin relative to the foot at rest; a displaced lobe equals a pin rotated back about the wheel's
        # bearing.
        qx = dx * ax + dy * ay + t[ERR_R + j] + turned * lever_y
        qy = dy * ax - dx * ay + t[ERR_T + j] - turned * lever_x
        v = (qx * gx + qy * ly) * ig
        u = (qy * gx - qx * ly) * ig
        # Foot of the displaced pin by one Newton step; the remaining error of u is of second order.
        s = u * ig * inv_ez / (1.0 + (a1 + a3 * i2) * ig * v)
        y = s * s
        s1 = s * (1.0 - y * (1.0 / 6.0) * (1.0 - y * (1.0 / 20.0)))
        v1 = y * 0.5 * (1.0 - y * (1.0 / 12.0) * (1.0 - y * (1.0 / 30.0)))
        s *= z + 1.0
        y = s * s
        s2 = s * (1.0 - y * (1.0 / 6.0) * (1.0 - y * (1.0 / 20.0) * (1.0 - y * (1.0 / 42.0))))
        v2 = y * 0.5 * (1.0 - y * (1.0 / 12.0) * (1.0 - y * (1.0 / 30.0) * (1.0 - y * (1.0 / 56.0))))
        turn_x = -lx * v2 - ly * s2
        turn_y = lx * s2 - ly * v2
        qx -= ecc * turn_x - p_ring * v1
        qy -= ecc * turn_y + p_ring * s1
        gx = inv_m * (1.0 - v1) + lx + turn_x
        gy = inv_m * s1 + ly + turn_y
        i2 = 1.0 / (gx * gx + gy * gy)
        ig = math.sqrt(i2)
        v = (qx * gx + qy * gy) * ig
        u = (qy * gx - qx * gy) * ig
        # Curvature there, and its change by arc length.
        bend = (a1 + a3 * i2) * ig
        change = steep * ((1.0 - v1) * gy - s1 * gx) * (a1 + 3.0 * a3 * i2) * i2 * i2
        x = u / (1.0 + bend * v)
        gap = v + 0.5 * bend * u * x
        tilt = x * (bend + 0.5 * change * x) + turned
        radius = q * (1.0 - q * (bend + change * x))
        # The pitch error, and with it the gap, changes along the profile.
        tilt -= t[SLOPE + j] * ig * inv_ez * (lever_x * gy - lever_y * gx) * ig
        along = 1.0 - 0.5 * tilt * tilt
        nx = (gx * along - gy * tilt) * ig
        ny = (gy * along + gx * tilt) * ig
        hx = cb * cx + sb * cy
        hy = cb * cy - sb * cx
        on_cam = hx * ny - hy * nx
        on_wheel = lever_x * ny - lever_y * nx
        closing = omega * on_cam + rate * on_wheel
        d = -gap if gap < 0.0 else 0.0
        rise = d * per_ramp
        rise = rise if rise < 1.0 else 1.0
        radius = radius if radius > 0.0 else 0.0
        elastic = hertz * rise * d * math.sqrt(radius * d)
        f = elastic + closing * (plain * rise + weighted * elastic)
        f = f * t[WEIGHT + j] if f > 0.0 else 0.0
        t[MOMENT + j] = f * on_wheel
        t[ON_CAM + j] = f * on_cam
        t[FLANK_X + j] = f * nx
        t[FLANK_Y + j] = f * ny
    moment = 0.0
    on_input = 0.0
    for j in range(np.uintp(N_PINS)):
        moment -= t[MOMENT + j]
        on_input += t[ON_CAM + j]
    return moment, on_input


@njit(nogil=True, cache=True, error_model="numpy")
def _holes(cx, cy, hole_x, hole_y, out_x, out_y, omega, rate, rate_out, p, t):
    """Contacts of the internal sleeves with one wheel: moments on wheel (about its cam), output and cam."""
    r = p[R_IN]
    hertz = p[K_HERTZ] * math.sqrt(p[RAD_IN])
    play = p[GAP_IN]
    per_ramp = 1.0 / p[RAMP]
    plain = 0.0 if p[HUNT_CROSSLEY] > 0.0 else p[DAMPING]
    weighted = p[DAMPING] if p[HUNT_CROSSLEY] > 0.0 else 0.0
    dx = r * (out_x - hole_x)
    dy = r * (out_y - hole_y)
    for k in range(np.uintp(N_IN)):
        ca = t[CA + k]
        sa = t[SA + k]
        hx = r * (ca * hole_x - sa * hole_y)
        hy = r * (sa * hole_x + ca * hole_y)
        wx = ca * dx - sa * dy - cx
        wy = sa * dx + ca * dy - cy
        distance = math.sqrt(wx * wx + wy * wy)
        inverse = 1.0 / distance
        nx = wx * inverse
        ny = wy * inverse
        on_wheel = hx * ny - hy * nx
        # The sleeve's lever is the hole's, the cam's arm and the way between them, which n lies along.
        on_cam = cx * ny - cy * nx
        on_out = on_wheel + on_cam
        closing = rate_out * on_out - rate * on_wheel - omega * on_cam
        over = distance - play
        d = over if over > 0.0 else 0.0
        rise = d * per_ramp
        rise = rise if rise < 1.0 else 1.0
        elastic = hertz * rise * d * math.sqrt(d)
        f = elastic + closing * (plain * rise + weighted * elastic)
        f = f if f > 0.0 else 0.0
        t[HOLE_F + k] = f
        t[HOLE_X + k] = nx
        t[HOLE_Y + k] = ny
        t[MOMENT + k] = f * on_wheel
        t[ON_OUT + k] = f * on_out
        t[ON_CAM + k] = f * on_cam
    on_wheel = 0.0
    on_out = 0.0
    on_input = 0.0
    for k in range(np.uintp(N_IN)):
        on_wheel += t[MOMENT + k]
        on_out -= t[ON_OUT + k]
        on_input -= t[ON_CAM + k]
    return on_wheel, on_out, on_input


@njit(nogil=True, cache=True, error_model="numpy")
def _pins_rub(cx, cy, omega, rate, p, t, state, rates):
    """Friction of the external sleeves on one wheel: moments on wheel and cam; adds to their spin."""
    moment = 0.0
    on_input = 0.0
    for j in range(np.uintp(N_PINS)):
        fx = t[EDGE_X + j] - t[FLANK_X + j]
        fy = t[EDGE_Y + j] - t[FLANK_Y + j]
        size = math.sqrt(fx * fx + fy * fy)
        if size == 0.0:
            continue
        # Outward direction of the wheel, and the lever of the contact point.
        mx = -fx / size
        my = -fy / size
        lever = t[LEVER_X + j] * mx + t[LEVER_Y + j] * my - p[Q]
        hx = t[CB + j] * cx + t[SB + j] * cy
        hy = t[CB + j] * cy - t[SB + j] * cx
        of_cam = hx * mx + hy * my
        slip = omega * of_cam + rate * lever + p[Q] * state[2 * N_ANGLES + j]
        rub = size * p[MU] * math.tanh(slip / p[SLIP_SPEED])
        moment -= rub * lever
        on_input += rub * of_cam
        rates[2 * N_ANGLES + j] -= p[Q] * rub / p[J_SLEEVE]
    return moment, on_input


@njit(nogil=True, cache=True, error_model="numpy")
def _holes_rub(cx, cy, out_x, out_y, omega, rate, rate_out, p, t, state, rates):
    """Friction of the internal sleeves in one wheel: moments on wheel, output and cam; adds to their spin."""
    moment = 0.0
    moment_out = 0.0
    on_input = 0.0
    for k in range(np.uintp(N_IN)):
        size = t[HOLE_F + k]
        if size == 0.0:
            continue
        nx = t[HOLE_X + k]
        ny = t[HOLE_Y + k]
        sx = p[R_IN] * (t[CA + k] * out_x - t[SA + k] * out_y)
        sy = p[R_IN] * (t[SA + k] * out_x + t[CA + k] * out_y)
        on_out = sx * nx + sy * ny
        of_cam = cx * nx + cy * ny
        lever = on_out + p[Q_IN] - of_cam
        at = 2 * N_ANGLES + N_PINS + k
        slip = omega * of_cam + rate * lever - rate_out * on_out - p[Q_IN] * state[at]
        rub = size * p[MU] * math.tanh(slip / p[SLIP_SPEED])
        moment -= rub * lever
        moment_out += rub * on_out
        on_input += rub * of_cam
        rates[at] += p[Q_IN] * rub / p[J_SLEEVE]
    return moment, moment_out, on_input


@njit(nogil=True, cache=True, error_model="numpy")
def _rates(drive, i, state, rates, p, t, mounts, worn, has_worn, pitch, lobes):
    """Right-hand side at half step ``i``; returns the torques that resist the output and turn the input."""
    omega = drive[1, i]
    push = drive[2, i] / p[Z]
    load = drive[3, i]
    cos_phi = drive[4, i]
    sin_phi = drive[5, i]
    cos_slow = drive[6, i]
    sin_slow = -drive[7, i]
    z = p[Z]
    mean_rate = -omega / z
    se, ce = _small(state[OUT])
    out_x = cos_slow * ce - sin_slow * se
    out_y = sin_slow * ce + cos_slow * se
    rate_out = mean_rate + state[N_ANGLES + OUT]
    moment_out = 0.0
    torque_in = 0.0
    friction = p[MU] > 0.0
    if friction:
        for k in range(2 * N_ANGLES, N_STATE):
            rates[k] = 0.0
    for w in range(2):
        eps = state[w]
        rate = mean_rate + state[N_ANGLES + w]
        # Directions of the holes, exp(i (eps - phi/z)), of the profile, and exp(-i z theta).
        se, ce = _small(eps)
        hole_x = cos_slow * ce - sin_slow * se
        hole_y = sin_slow * ce + cos_slow * se
        ct = hole_x * mounts[w, 1] - hole_y * mounts[w, 2]
        st = hole_y * mounts[w, 1] + hole_x * mounts[w, 2]
        se, ce = _small(z * eps)
        side = 2.0 * w - 1.0  # exp(-i z rest)
        cl = side * (cos_phi * ce + sin_phi * se)
        sl = side * (sin_phi * ce - cos_phi * se)
        cx = mounts[w, 3] * cos_phi - mounts[w, 4] * sin_phi
        cy = mounts[w, 3] * sin_phi + mounts[w, 4] * cos_phi
        rx = mounts[w, 5]
        ry = mounts[w, 6]
        # From the foot at rest to the pin, in the wheel's frame and the same for all pins.
        dx = -(cx * ct + cy * st) - p[ECC] * (ct * cl + st * sl) - rx
        dy = -(cy * ct - cx * st) - p[ECC] * (ct * sl - st * cl) - ry
        ring = p[RING]
        for j in range(np.uintp(N_PINS)):
            # Lever from the cam to the pin, and the run-out, in the pin's frame.
            cb = t[CB + j]
            sb = t[SB + j]
            t[LEVER_X + j] = ring + t[ERR_R + j] - (cb * cx + sb * cy)
            t[LEVER_Y + j] = t[ERR_T + j] - (cb * cy - sb * cx)
            ax = cb * ct + sb * st
            ay = sb * ct - cb * st
            t[RUN_X + j] = ax * rx + ay * ry
            t[RUN_Y + j] = ax * ry - ay * rx
            t[WEIGHT + j] = 1.0
            t[EDGE_X + j] = 0.0
            t[EDGE_Y + j] = 0.0
        moment = 0.0
        if p[HAS_PITCH] > 0.0:
            _pitch_errors(w, eps - drive[0, i] / z + mounts[w, 0], t, pitch)
        if has_worn[w] == 1:
            theta = eps - drive[0, i] / z + mounts[w, 0]
            on_wheel, on_input = _edges(w, theta, cx, cy, ct, st, omega, rate, p, t, worn, pitch, lobes)
            moment += on_wheel
            torque_in += on_input
        on_wheel, on_input = _flanks(dx, dy, cx, cy, ct, st, cl, sl, omega, rate, p, t)
        moment += on_wheel
        torque_in += on_input
        if friction:
            on_wheel, on_input = _pins_rub(cx, cy, omega, rate, p, t, state, rates)
            moment += on_wheel
            torque_in += on_input
        on_wheel, on_out, on_input = _holes(cx, cy, hole_x, hole_y, out_x, out_y, omega, rate, rate_out, p, t)
        moment += on_wheel
        moment_out += on_out
        torque_in += on_input
        if friction:
            on_wheel, on_out, on_input = _holes_rub(
                cx, cy, out_x, out_y, omega, rate, rate_out, p, t, state, rates
            )
            moment += on_wheel
            moment_out += on_out
            torque_in += on_input
        rates[w] = state[N_ANGLES + w]
        rates[N_ANGLES + w] = moment / p[J_WHEEL] + push
    if p[BEARING] > 0.0:
        moment_out -= p[BEARING] * math.tanh(rate_out / p[BEARING_SPEED])
    for k in range(OUT, N_ANGLES):
        rates[k] = state[N_ANGLES + k]
        rates[N_ANGLES + k] = 0.0
    if p[J_ROTOR] == 0.0:
        rates[N_ANGLES + OUT] = (moment_out + load) / p[J_OUT] + push
        return -moment_out, torque_in
    meter = p[K_METER] * (state[ROTOR] - state[OUT])
    meter += p[C_METER] * (state[N_ANGLES + ROTOR] - state[N_ANGLES + OUT])
    rates[N_ANGLES + OUT] = (moment_out + meter) / p[J_OUT] + push
    behind = load
    if p[J_SECOND] > 0.0:
        behind = p[K_SECOND] * (state[SECOND] - state[ROTOR])
        behind += p[C_SECOND] * (state[N_ANGLES + SECOND] - state[N_ANGLES + ROTOR])
        rates[N_ANGLES + SECOND] = (load - behind) / p[J_SECOND] + push
    rates[N_ANGLES + ROTOR] = (behind - meter) / p[J_ROTOR] + push
    return meter, torque_in


@njit(nogil=True, cache=True, error_model="numpy")
def _integrate(n_steps, h, drive, p, t, mounts, worn, pitch, lobes, torque):
    """Integrate by third-order Adams-Bashforth and return the number of steps done.

    ``torque`` (2, n_steps), at output and input, is at the start of each step; ``drive`` (8, n_steps): input
    angle, speed, acceleration, load, and the cosines and sines of the angle and of a fifteenth of it.
    """
    state = np.zeros(N_STATE)
    k0 = np.zeros(N_STATE)
    k1 = np.zeros(N_STATE)
    k2 = np.zeros(N_STATE)
    has_worn = np.zeros(2, dtype=np.int64)
    for w in range(2):
        for lobe in range(15):
            if worn[w, lobe] == 1:
                has_worn[w] = 1
    n = N_STATE if p[MU] > 0.0 else 2 * N_ANGLES
    for i in range(n_steps):
        torque[0, i], torque[1, i] = _rates(drive, i, state, k0, p, t, mounts, worn, has_worn, pitch, lobes)
        if not abs(torque[0, i]) < ABSURD:
            return i
        for s in range(n):
            state[s] += h / 12.0 * (23.0 * k0[s] - 16.0 * k1[s] + 5.0 * k2[s])
            k2[s] = k1[s]
            k1[s] = k0[s]
    return n_steps


RAMP_TIME = 0.2


def times(n_samples: int) -> Float:
    """Times in s at which :func:`run` expects fluctuations of load and speed."""
    return np.arange((n_samples + MARGIN) * OVERSAMPLING) * STEP


def run(
    machine: Machine,
    n_samples: int,
    start_angle: float = 0.0,
    load_extra: Float | float = 0.0,
    speed_extra: Float | float = 0.0,
) -> tuple[Float, Float, Float]:
    """Torque at output and input in Nm, and input angle in rad, at 25.6 kHz and from rest.

    ``load_extra`` (Nm) and ``speed_extra`` (rad/s) are given at :func:`times` and rise with the ramp of
    speed and load, 0.2 s.
    """
    time = times(n_samples)
    rise = np.minimum(time / RAMP_TIME, 1.0)
    omega = rise * (machine.speed + speed_extra)
    alpha = np.where(time < RAMP_TIME, machine.speed / RAMP_TIME, 0.0)
    phi = machine.speed * np.where(time < RAMP_TIME, time**2 / (2 * RAMP_TIME), time - RAMP_TIME / 2)
    if np.ndim(speed_extra):
        more = rise * speed_extra
        alpha += np.gradient(more, STEP)
        phi += np.r_[0.0, np.cumsum(more[1:] + more[:-1])] * (STEP / 2)
    phi += start_angle
    load = rise * (machine.load + load_extra)
    slow = phi / 15
    drive = np.array([phi, omega, alpha, load, np.cos(phi), np.sin(phi), np.cos(slow), np.sin(slow)])
    torque = np.empty((2, time.size))
    p = machine.numbers()
    t = np.zeros(int(N_ROWS))
    beta = 2 * np.pi * np.arange(N_PINS) / N_PINS
    around = np.pi / 4 * np.arange(N_IN)
    pins = np.asarray(machine.pins)
    rows = {CB: np.cos(beta), SB: np.sin(beta), ERR_R: pins.real, ERR_T: pins.imag}
    for row, values in (rows | {CA: np.cos(around), SA: np.sin(around)}).items():
        t[int(row) : int(row) + len(values)] = values
    mounts = np.zeros((2, 7))
    for w, (sign, rest) in enumerate(((1, -math.pi / 15), (-1, 14 * math.pi / 15))):
        cam = sign * p[ECC] + complex(machine.cams[w])
        runout = complex(machine.runouts[w])
        mounts[w] = rest, math.cos(rest), math.sin(rest), cam.real, cam.imag, runout.real, runout.imag
    lobes = PITCH * np.arange(15)
    done = _integrate(
        time.size, STEP, drive, p, t, mounts, np.asarray(machine.worn, dtype=np.int64),
        np.asarray(machine.pitch, dtype=float), np.array([np.cos(lobes), np.sin(lobes)]), torque,
    )  # fmt: skip
    if done < time.size:
        raise RuntimeError(f"the simulation diverged at t = {done * STEP:.4f} s with {machine}")
    # Edge and length of the filter are those for a conversion from 100 kHz: 10 samples on either side.
    kept = resample_poly(torque, 1, OVERSAMPLING, axis=1)[:, :n_samples]
    return kept[0], kept[1], phi[::OVERSAMPLING][:n_samples].copy()
