"""The reduced gearbox model in numba: floats and arrays only.

State of one gearbox, all as deviations from the rest position that follows the input angle phi:

====  =====================================  =======================================
0     eps_1 = theta_1 + (phi + pi)/z_s       wheel 1
1     eps_2 = theta_2 + phi/z_s - rest_2     wheel 2
2     eps_out = psi + phi/z_s                output shaft
3     eps_brake = psi_b + phi/z_s            rotor of the brake, behind the torque meter
4-7   their rates
8-    rates of the sleeves' own spin         external, then internal; with friction only
====  =====================================  =======================================

The deviations are small (contact penetration over radius): short polynomials give the sines and cosines of
the moving parts from those of phi and phi/z_s. :mod:`~cyclofeat.simulators._outline` describes the contacts
of pins and wheels.
"""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.simulators import _outline as rows
from cyclofeat.simulators._jit import addresses, njit
from cyclofeat.simulators._outline import FASTMATH, describe, moved_on, small_sincos

# Of _outline.py: numba's cache on disk notices changes of this file only.
OUTLINE_CHECKSUM = 0x788C62FD

PAPER_LAW = 0
HUNT_CROSSLEY_LAW = 1
CONSERVATIVE_LAW = 2

# Named tuples of numbers only: an array inside one would be reference-counted at every call.
ContactConstants = namedtuple(
    "ContactConstants",
    [
        "law",  # one of the *_LAW constants
        "stiffness_factor",  # K / sqrt(effective radius), N/m^2
        "damping",  # C, Ns/m (Hunt-Crossley: relative damping, s/m)
        "inverse_ramp",  # one over the penetration over which K and C rise, 1/m
        "constant_radius",  # effective radius of the conservative law, m
    ],
)

JointConstants = namedtuple(
    "JointConstants",
    [
        "n_sleeves",
        "pitch_radius",  # of the internal sleeves, m
        "sleeve_radius",  # m
        "gap_at_centre",  # hole radius minus sleeve radius, m
    ],
)

# As the fields of the gearbox. Without inertia of the brake the load acts on the output shaft itself.
BodyConstants = namedtuple(
    "BodyConstants",
    ["wheel_mass", "wheel_inertia", "output_inertia", "brake_inertia", "meter_stiffness", "meter_damping"],
)

# As the fields of the gearbox; the friction at rest stands where the gearbox has 0 for the same.
FrictionConstants = namedtuple(
    "FrictionConstants",
    [
        "sleeve_friction", "sleeve_static_friction", "stribeck_speed", "sleeve_viscous_friction",
        "journal_friction", "friction_transition_speed", "input_bearing_torque", "input_bearing_viscosity",
        "output_bearing_torque", "output_bearing_viscosity", "bearing_transition_speed", "sleeve_inertia",
    ],
)  # fmt: skip

# Tables of the internal sleeves: rows of one length, as in the outline's.
SLEEVE_COS, SLEEVE_SIN = (np.uintp(row * rows.COLUMNS) for row in range(2))
# Per wheel and sleeve: force, its vector on the wheel in the fixed frame, and the vector with friction, which
# presses the sleeve on its axle.
S_FORCE, S_X, S_Y, S_LOAD_X, S_LOAD_Y = (np.uintp(row * rows.COLUMNS) for row in range(5))
JOINT_SIZE = 5 * rows.COLUMNS
# The same per wheel and pin, gathered from flanks and edges on demand.
P_FORCE, P_X, P_Y = (np.uintp(row * rows.COLUMNS) for row in range(3))
PIN_FORCE_SIZE = 3 * rows.COLUMNS

N_STATE = 8
N_RESULT = 2  # torque_out, torque_in


@njit(fastmath=FASTMATH, inline="always")
def contact_force(penetration, rate, radius, contact):
    """Normal force of one contact in N (paper B eq. 11-14): never tensile, zero when open.

    ``rate`` is the rate of penetration in m/s, ``radius`` the effective radius in m.
    """
    if contact.law == CONSERVATIVE_LAW:
        radius = contact.constant_radius
    depth = max(penetration, 0.0)
    rise = min(depth * contact.inverse_ramp, 1.0)
    elastic = contact.stiffness_factor * rise * depth * np.sqrt(radius * depth)
    if contact.law == HUNT_CROSSLEY_LAW:
        return max(elastic * (1.0 + contact.damping * rate), 0.0)
    return max(elastic + contact.damping * rise * rate, 0.0)


@njit(fastmath=FASTMATH, inline="always")
def flank_contact(flanks, k, has_faults, ct, st, cx, cy):
    """Gap of one flank, lever arms of its force, tilt, effective radius and weight.

    ``ct, st`` turn the wheel from its description to now; ``c`` is the cam's centre in the axes of the
    description. With m the direction of the force on pin p, the arms about the origin are c x m and p x m;
    the tilt is m's component along t.
    """
    nx, ny = flanks[rows.F_NX + k], flanks[rows.F_NY + k]
    pin_n = ct * flanks[rows.F_ALONG_N + k] + st * flanks[rows.F_ALONG_T + k]
    pin_t = ct * flanks[rows.F_ALONG_T + k] - st * flanks[rows.F_ALONG_N + k]
    cam_n, cam_t = cx * nx + cy * ny, cy * nx - cx * ny
    v = pin_n - cam_n - flanks[rows.F_V + k]
    u = pin_t - cam_t - flanks[rows.F_U + k]
    bend = flanks[rows.F_BEND + k]
    bend = bend - bend * bend * v
    third = flanks[rows.F_CHANGE + k]
    slope = flanks[rows.F_SLOPE + k]
    gap = flanks[rows.F_GAP + k] + v + u * (slope + u * (0.5 * bend + third * u))
    tilt = slope + u * (bend + 3.0 * third * u)
    along = 1.0 - 0.5 * tilt * tilt
    cam_arm, pin_arm = cam_n * tilt - cam_t * along, pin_n * tilt - pin_t * along
    radius_slope = flanks[rows.F_RADIUS_SLOPE + k] + flanks[rows.F_RADIUS_BEND + k] * u
    radius = max(flanks[rows.F_RADIUS + k] + radius_slope * u, 0.0)
    weight = 1.0
    if has_faults:
        line = flanks[rows.F_LINE + k] + flanks[rows.F_LINE_V + k] * v + flanks[rows.F_LINE_U + k] * u
        # Read both before the choice: a read inside it would be a branch.
        before, beyond = flanks[rows.F_BEFORE + k], flanks[rows.F_BEYOND + k]
        weight = beyond if line >= 0.0 else before
    return gap, cam_arm, pin_arm, tilt, radius, weight


@njit(fastmath=FASTMATH, inline="always")
def edge_contact(edges, k, pin_radius, ct, st, cx, cy):
    """As :func:`flank_contact`, for one edge; the direction's parts along n and t in place of the tilt."""
    nx, ny = edges[rows.E_NX + k], edges[rows.E_NY + k]
    pin_n = ct * edges[rows.E_ALONG_N + k] + st * edges[rows.E_ALONG_T + k]
    pin_t = ct * edges[rows.E_ALONG_T + k] - st * edges[rows.E_ALONG_N + k]
    cam_n, cam_t = cx * nx + cy * ny, cy * nx - cx * ny
    v = pin_n - cam_n - edges[rows.E_V + k]
    u = pin_t - cam_t - edges[rows.E_U + k]
    line = edges[rows.E_LINE + k] + edges[rows.E_LINE_V + k] * v + edges[rows.E_LINE_U + k] * u
    beside = min(u, edges[rows.E_BESIDE + k])
    square = v * v + beside * beside
    distance = np.sqrt(square)
    inverse = distance * (1.0 / square)  # root and quotient at the same time
    along = v * inverse
    tilt = beside * inverse
    cam_arm, pin_arm = cam_n * tilt - cam_t * along, pin_n * tilt - pin_t * along
    # Between profile and chord the effective radius follows the direction of the normal.
    turned = min(max(along + edges[rows.E_TURN + k] * tilt, 0.0), 1.0)
    radius = edges[rows.E_RADIUS + k] + turned * edges[rows.E_RADIUS_SPAN + k]
    weight = edges[rows.E_WEIGHT + k] * (line >= 0.0)
    return distance - pin_radius, cam_arm, pin_arm, along, tilt, radius, weight


@njit(fastmath=FASTMATH, inline="always")
def _flank_contacts(first, n, has_faults, contact, flanks, ct, st, cx, cy, omega, rate):
    """Moments of the forces of all flanks on the wheel: c x F about the origin, and about the cam."""
    on_cam, on_pin = 0.0, 0.0
    swing = rate - omega
    for i in range(n):
        k = first + i
        gap, cam_arm, pin_arm, tilt, radius, weight = flank_contact(flanks, k, has_faults, ct, st, cx, cy)
        f = weight * contact_force(-gap, rate * pin_arm - swing * cam_arm, radius, contact)
        flanks[rows.F_FORCE + k] = f
        flanks[rows.F_TILT + k] = tilt
        on_cam -= f * cam_arm
        on_pin -= f * pin_arm
    return on_cam, on_pin - on_cam


@njit(fastmath=FASTMATH, inline="always")
def _edge_contacts(first, n, contact, edges, pin_radius, ct, st, cx, cy, omega, rate):
    """As :func:`_flank_contacts`, for all edges."""
    on_cam, on_pin = 0.0, 0.0
    swing = rate - omega
    for i in range(n):
        k = first + i
        gap, cam_arm, pin_arm, along, tilt, radius, weight = edge_contact(
            edges, k, pin_radius, ct, st, cx, cy
        )
        f = weight * contact_force(-gap, rate * pin_arm - swing * cam_arm, radius, contact)
        edges[rows.E_FORCE + k] = f
        edges[rows.E_ALONG + k] = along
        edges[rows.E_TILT + k] = tilt
        on_cam -= f * cam_arm
        on_pin -= f * pin_arm
    return on_cam, on_pin - on_cam


@njit(fastmath=FASTMATH, inline="always")
def _joint_contacts(
    first, joint, contact, sleeves, carried, cx, cy, omega, cos_out, sin_out, cos_hole, sin_hole, rate_out,
    rate,
):  # fmt: skip
    """Contacts of all internal sleeves with the holes of one wheel.

    Returns the moments of the forces on the wheel (at the cam about the origin, and about the cam) and on the
    output shaft. With h, o and s = o - h the hole, the sleeve and the way between them at angle 0, the others
    are turned by the sleeve's angle: |s - c|^2, the rate of penetration and all lever arms are sums of a
    constant, a cosine and a sine, so that the loop needs three sums of forces over distances.
    """
    r = joint.pitch_radius
    hx, hy = r * cos_hole, r * sin_hole
    sx, sy = r * (cos_out - cos_hole), r * (sin_out - sin_hole)
    # Products with c of vectors that are turned: their part at the cosine and at the sine.
    hole_c, hole_s = hx * cy - hy * cx, -(hy * cy + hx * cx)
    way_c, way_s = sx * cy - sy * cx, -(sy * cy + sx * cx)
    out_c, out_s = hole_c + way_c, hole_s + way_s
    lever = hx * sy - hy * sx
    square_0 = sx * sx + sy * sy + cx * cx + cy * cy
    square_c, square_s = 2.0 * way_s, -2.0 * way_c
    rate_0 = (rate_out - rate) * lever
    rate_c = rate * hole_c - rate_out * out_c + omega * way_c
    rate_s = rate * hole_s - rate_out * out_s + omega * way_s
    sum_0 = 0.0
    sum_c, sum_s = 0.0, 0.0
    for k in range(np.uintp(joint.n_sleeves)):
        ca, sa = sleeves[SLEEVE_COS + k], sleeves[SLEEVE_SIN + k]
        square = square_0 + ca * square_c + sa * square_s
        distance = np.sqrt(square)
        inverse = distance * (1.0 / square)  # root and quotient at the same time
        penetration_rate = (rate_0 + ca * rate_c + sa * rate_s) * inverse
        f = contact_force(distance - joint.gap_at_centre, penetration_rate, contact.constant_radius, contact)
        carried[first + S_FORCE + k] = f
        over = f * inverse
        sum_0 += over
        sum_c += over * ca
        sum_s += over * sa
    on_cam = sum_c * way_c + sum_s * way_s
    on_wheel = lever * sum_0 - (hole_c * sum_c + hole_s * sum_s)
    on_output = out_c * sum_c + out_s * sum_s - lever * sum_0
    return -on_cam, on_wheel, on_output


@njit(fastmath=FASTMATH)
def _joint_vectors(w, joint, sleeves, carried, cx, cy, cos_out, sin_out, cos_hole, sin_hole):
    """Write the vectors on wheel ``w`` of the forces that the internal sleeves carry."""
    first = np.uintp(w * JOINT_SIZE)
    sx, sy = joint.pitch_radius * (cos_out - cos_hole), joint.pitch_radius * (sin_out - sin_hole)
    for k in range(np.uintp(joint.n_sleeves)):
        ca, sa = sleeves[SLEEVE_COS + k], sleeves[SLEEVE_SIN + k]
        dx, dy = ca * sx - sa * sy - cx, sa * sx + ca * sy - cy
        over = carried[first + S_FORCE + k] / np.sqrt(dx * dx + dy * dy)
        carried[first + S_X + k] = over * dx
        carried[first + S_Y + k] = over * dy


@njit(fastmath=FASTMATH)
def gather_pin_forces(w, counts, flanks, edges, turned_cos, turned_sin, n_pins, carried):
    """Force of every pin on wheel ``w``: magnitudes added, and the vector on the wheel in the fixed frame."""
    own = np.uintp(w * rows.COLUMNS)
    first = np.uintp(w * PIN_FORCE_SIZE)
    for i in range(np.uintp(n_pins)):
        carried[first + P_FORCE + i] = 0.0
        carried[first + P_X + i] = 0.0
        carried[first + P_Y + i] = 0.0
    for i in range(counts[own + rows.USED_FLANKS]):
        k = np.uintp(w * rows.FLANK_SIZE) + i
        j = first + np.uintp(flanks[rows.F_PIN + k])
        carried[P_FORCE + j] += flanks[rows.F_FORCE + k]
        tilt = flanks[rows.F_TILT + k]
        along = 1.0 - 0.5 * tilt * tilt
        fx = flanks[rows.F_FORCE + k] * (along * flanks[rows.F_NX + k] - tilt * flanks[rows.F_NY + k])
        fy = flanks[rows.F_FORCE + k] * (along * flanks[rows.F_NY + k] + tilt * flanks[rows.F_NX + k])
        carried[P_X + j] -= turned_cos * fx - turned_sin * fy
        carried[P_Y + j] -= turned_sin * fx + turned_cos * fy
    for i in range(counts[own + rows.USED_EDGES]):
        k = np.uintp(w * rows.EDGE_SIZE) + i
        j = first + np.uintp(edges[rows.E_PIN + k])
        carried[P_FORCE + j] += edges[rows.E_FORCE + k]
        fx = edges[rows.E_FORCE + k] * (
            edges[rows.E_ALONG + k] * edges[rows.E_NX + k] - edges[rows.E_TILT + k] * edges[rows.E_NY + k]
        )
        fy = edges[rows.E_FORCE + k] * (
            edges[rows.E_ALONG + k] * edges[rows.E_NY + k] + edges[rows.E_TILT + k] * edges[rows.E_NX + k]
        )
        carried[P_X + j] -= turned_cos * fx - turned_sin * fy
        carried[P_Y + j] -= turned_sin * fx + turned_cos * fy


@njit(fastmath=FASTMATH, inline="always")
def _sleeve_friction(slip, force, friction):
    """Coulomb, Stribeck and viscous friction in N of a sleeve that is pressed with ``force``."""
    ratio = slip / friction.stribeck_speed
    at_rest = friction.sleeve_static_friction - friction.sleeve_friction
    coefficient = friction.sleeve_friction + at_rest * np.exp(-ratio * ratio)
    viscous = friction.sleeve_viscous_friction * slip if force > 0.0 else 0.0
    return force * coefficient * np.tanh(slip / friction.friction_transition_speed) + viscous


@njit(fastmath=FASTMATH, inline="always")
def bearing_friction(speed, coulomb, viscous, friction):
    """Torque in Nm that a shaft's bearing opposes to its speed in rad/s."""
    return coulomb * np.tanh(speed / friction.bearing_transition_speed) + viscous * speed


@njit(fastmath=FASTMATH)
def _pin_friction(w, wheel, friction, pins, carried, cx, cy, cvx, cvy, rate, state, torques):
    """Friction of all pins on wheel ``w``: force and moment on the wheel; adds to the sleeves' torques."""
    q = wheel.pin_radius
    total_x, total_y = 0.0, 0.0
    moment = 0.0
    first = np.uintp(w * PIN_FORCE_SIZE)
    for j in range(np.uintp(wheel.n_lobes + 1)):
        fx, fy = carried[first + P_X + j], carried[first + P_Y + j]
        force = np.sqrt(fx * fx + fy * fy)
        if force == 0.0:
            continue
        # m points out of the wheel; a pin that touches twice rubs where the resultant acts
        mx, my = -fx / force, -fy / force
        radial = wheel.pin_circle_radius + pins[rows.PIN_RADIAL_ERROR + j]
        tangential = pins[rows.PIN_TANGENTIAL_ERROR + j]
        ax = pins[rows.PIN_COS + j] * radial - pins[rows.PIN_SIN + j] * tangential - cx - q * mx
        ay = pins[rows.PIN_SIN + j] * radial + pins[rows.PIN_COS + j] * tangential - cy - q * my
        lever = ax * mx + ay * my
        slip = cvy * mx - cvx * my + rate * lever + q * state[np.uintp(N_STATE) + j]
        rub = _sleeve_friction(slip, force, friction)
        total_x += rub * my
        total_y -= rub * mx
        moment -= rub * lever
        torques[j] -= q * rub
        carried[first + P_X + j] += rub * my
        carried[first + P_Y + j] -= rub * mx
    return total_x, total_y, moment


@njit(fastmath=FASTMATH)
def _joint_friction(
    w, n_pins, joint, friction, sleeves, carried, cx, cy, cvx, cvy, cos_out, sin_out, rate_out, rate, state,
    torques,
):  # fmt: skip
    """Friction of internal sleeves in one wheel's holes: force and moment on it, moment on the output."""
    total_x, total_y = 0.0, 0.0
    moment, moment_out = 0.0, 0.0
    r = joint.pitch_radius
    q = joint.sleeve_radius
    first = np.uintp(w * JOINT_SIZE)
    for k in range(np.uintp(joint.n_sleeves)):
        fx, fy = carried[first + S_X + k], carried[first + S_Y + k]
        force = np.sqrt(fx * fx + fy * fy)
        carried[first + S_LOAD_X + k] = 0.0
        carried[first + S_LOAD_Y + k] = 0.0
        if force == 0.0:
            continue
        nx, ny = fx / force, fy / force
        sx = r * (sleeves[SLEEVE_COS + k] * cos_out - sleeves[SLEEVE_SIN + k] * sin_out)
        sy = r * (sleeves[SLEEVE_SIN + k] * cos_out + sleeves[SLEEVE_COS + k] * sin_out)
        ax, ay = sx + q * nx - cx, sy + q * ny - cy
        lever = ax * nx + ay * ny
        spin = state[np.uintp(N_STATE + n_pins) + k]
        # wheel minus sleeve at the contact, along n turned by a quarter turn
        slip = (cvy * nx - cvx * ny + rate * lever) - rate_out * (sx * nx + sy * ny) - spin * q
        rub = _sleeve_friction(slip, force, friction)
        total_x += rub * ny
        total_y -= rub * nx
        moment -= rub * lever
        torques[np.uintp(n_pins) + k] += q * rub
        moment_out += rub * (sx * nx + sy * ny)
        carried[first + S_LOAD_X + k] = fx + rub * ny
        carried[first + S_LOAD_Y + k] = fy - rub * nx
    return total_x, total_y, moment, moment_out


@njit(fastmath=FASTMATH, forceinline=True)
def derivatives(
    phi, cos_phi, sin_phi, cos_slow, sin_slow, omega, alpha, load, state, machine, friction, memory, rates,
    result,
):  # fmt: skip
    """Right-hand side of the reduced model.

    ``slow`` stands for exp(-i phi / z_s), ``machine`` for the constants and tables without ``friction``,
    which is None or FrictionConstants, ``memory`` for the tuple of arrays of :func:`new_memory`. Writes the
    derivative of ``state`` into ``rates`` and output and input torque into ``result``.
    """
    wheel, joint, contact, joint_contact, body, pins, mounts, lobes, wear, sleeves = machine
    seen, counts, feet, flanks, edges, on_sleeves, on_pins, torques = memory
    z = float(wheel.n_lobes)
    mean_rate = -omega / z
    mean_acceleration = -alpha / z
    out_sin, out_cos = small_sincos(state[2])
    cos_out, sin_out = cos_slow * out_cos - sin_slow * out_sin, sin_slow * out_cos + cos_slow * out_sin
    rate_out = mean_rate + state[6]
    moment_out = 0.0
    torque_in = 0.0
    if friction is not None:
        for k in range(np.uintp(wheel.n_lobes + 1 + joint.n_sleeves)):
            torques[k] = 0.0
    for w in range(2):
        own = np.uintp(w * rows.COLUMNS)
        side = 1.0 - 2.0 * w
        eps = state[w]
        cx = mounts[own + rows.CAM_X] * cos_phi - mounts[own + rows.CAM_Y] * sin_phi
        cy = mounts[own + rows.CAM_X] * sin_phi + mounts[own + rows.CAM_Y] * cos_phi
        cvx, cvy = -omega * cy, omega * cx
        rate = mean_rate + state[4 + w]
        # Direction of the holes, eps - phi/z_s, and of the profile, theta = eps - phi/z_s + rest angle.
        eps_sin, eps_cos = small_sincos(eps)
        cos_hole, sin_hole = cos_slow * eps_cos - sin_slow * eps_sin, sin_slow * eps_cos + cos_slow * eps_sin
        if moved_on(seen, w, wheel, phi, eps):
            # exp(-i z_s theta) = -exp(i phi_w) exp(-i z_s eps), phi_w the angle of the wheel's own cam.
            lobe_eps_sin, lobe_eps_cos = small_sincos(z * eps)
            describe(
                w, wheel, pins, mounts, lobes, wear, feet, flanks, edges, seen, counts, phi,
                eps,
                cos_hole * mounts[own + rows.REST_COS] - sin_hole * mounts[own + rows.REST_SIN],
                sin_hole * mounts[own + rows.REST_COS] + cos_hole * mounts[own + rows.REST_SIN],
                cx, cy,
                -side * (cos_phi * lobe_eps_cos + sin_phi * lobe_eps_sin),
                -side * (sin_phi * lobe_eps_cos - cos_phi * lobe_eps_sin),
            )  # fmt: skip
        # Turned since the description, and cam and its velocity in the axes of that time.
        st, ct = small_sincos(eps - seen[own + rows.SEEN_EPS] - (phi - seen[own + rows.SEEN_PHI]) / z)
        own_cx, own_cy = ct * cx + st * cy, ct * cy - st * cx
        first, n_flanks = np.uintp(w * rows.FLANK_SIZE), counts[own + rows.N_FLANKS]
        if mounts[own + rows.HAS_FAULTS] != 0.0:
            on_cam, moment = _flank_contacts(
                first, n_flanks, True, contact, flanks, ct, st, own_cx, own_cy, omega, rate
            )
            if counts[own + rows.N_EDGES] > 0:
                edges_on_cam, edges_moment = _edge_contacts(
                    np.uintp(w * rows.EDGE_SIZE), counts[own + rows.N_EDGES], contact, edges,
                    wheel.pin_radius, ct, st, own_cx, own_cy, omega, rate,
                )  # fmt: skip
                on_cam += edges_on_cam
                moment += edges_moment
        else:
            on_cam, moment = _flank_contacts(
                first, n_flanks, False, contact, flanks, ct, st, own_cx, own_cy, omega, rate
            )
        joint_on_cam, joint_moment, on_output = _joint_contacts(
            np.uintp(w * JOINT_SIZE), joint, joint_contact, sleeves, on_sleeves, cx, cy, omega, cos_out,
            sin_out, cos_hole, sin_hole, rate_out, rate,
        )  # fmt: skip
        on_cam += joint_on_cam
        moment += joint_moment
        moment_out += on_output
        if friction is not None:
            gather_pin_forces(w, counts, flanks, edges, ct, st, wheel.n_lobes + 1, on_pins)
            _joint_vectors(w, joint, sleeves, on_sleeves, cx, cy, cos_out, sin_out, cos_hole, sin_hole)
            fx, fy, m = _pin_friction(
                w, wheel, friction, pins, on_pins, cx, cy, cvx, cvy, rate, state, torques
            )
            on_cam += cx * fy - cy * fx
            moment += m
            fx, fy, m, on_output = _joint_friction(
                w, wheel.n_lobes + 1, joint, friction, sleeves, on_sleeves, cx, cy, cvx, cvy, cos_out,
                sin_out, rate_out, rate, state, torques,
            )  # fmt: skip
            on_cam += cx * fy - cy * fx
            moment += m
            moment_out += on_output
        rates[w] = state[4 + w]
        rates[4 + w] = moment / body.wheel_inertia - mean_acceleration
        # Moment about the input shaft of the cam's force on the wheel.
        torque_in += body.wheel_mass * alpha * (cx * cx + cy * cy) - on_cam
    if friction is not None:
        moment_out += _sleeve_rates(
            wheel, joint, friction, state, rate_out, on_pins, on_sleeves, torques, rates
        )
        moment_out -= bearing_friction(
            rate_out, friction.output_bearing_torque, friction.output_bearing_viscosity, friction
        )
        torque_in += bearing_friction(
            omega, friction.input_bearing_torque, friction.input_bearing_viscosity, friction
        )
    rates[2] = state[6]
    rates[3] = state[7]
    if body.brake_inertia > 0.0:
        meter = body.meter_stiffness * (state[3] - state[2]) + body.meter_damping * (state[7] - state[6])
        rates[6] = (moment_out + meter) / body.output_inertia - mean_acceleration
        rates[7] = (load - meter) / body.brake_inertia - mean_acceleration
        result[0] = meter
    else:
        rates[6] = (moment_out + load) / body.output_inertia - mean_acceleration
        rates[7] = 0.0
        result[0] = -moment_out
    result[1] = torque_in


@njit(fastmath=FASTMATH)
def _sleeve_rates(wheel, joint, friction, state, rate_out, on_pins, on_sleeves, torques, rates):
    """Spin of all sleeves on their axles; return the journals' moment on the output shaft.

    Axles of external sleeves are fixed, those of internal sleeves turn with the output shaft.
    """
    n_pins = np.uintp(wheel.n_lobes + 1)
    second_pins = np.uintp(PIN_FORCE_SIZE)
    second_sleeves = np.uintp(JOINT_SIZE)
    for j in range(n_pins):
        fx = on_pins[P_X + j] + on_pins[second_pins + P_X + j]
        fy = on_pins[P_Y + j] + on_pins[second_pins + P_Y + j]
        q = wheel.pin_radius
        spin = state[np.uintp(N_STATE) + j]
        grip = friction.journal_friction * q * np.sqrt(fx * fx + fy * fy)
        drag = grip * np.tanh(spin * q / friction.friction_transition_speed)
        rates[np.uintp(N_STATE) + j] = (torques[j] - drag) / friction.sleeve_inertia
    moment_out = 0.0
    for k in range(np.uintp(joint.n_sleeves)):
        fx = on_sleeves[S_LOAD_X + k] + on_sleeves[second_sleeves + S_LOAD_X + k]
        fy = on_sleeves[S_LOAD_Y + k] + on_sleeves[second_sleeves + S_LOAD_Y + k]
        q = joint.sleeve_radius
        at = np.uintp(N_STATE) + n_pins + k
        grip = friction.journal_friction * q * np.sqrt(fx * fx + fy * fy)
        drag = grip * np.tanh((state[at] - rate_out) * q / friction.friction_transition_speed)
        rates[at] = (torques[n_pins + k] - drag) / friction.sleeve_inertia
        moment_out += drag
    return moment_out


@njit(fastmath=FASTMATH)
def gather(wheel, joint, mounts, sleeves, memory, phi, state, external, internal):
    """Forces of all sleeves at the last evaluation: (2, n_sleeves, 3), magnitude and vector on the wheel."""
    seen, counts, _, flanks, edges, on_sleeves, on_pins, _ = memory
    z = float(wheel.n_lobes)
    for w in range(2):
        own = np.uintp(w * rows.COLUMNS)
        st, ct = small_sincos(state[w] - seen[own + rows.SEEN_EPS] - (phi - seen[own + rows.SEEN_PHI]) / z)
        gather_pin_forces(w, counts, flanks, edges, ct, st, wheel.n_lobes + 1, on_pins)
        first = np.uintp(w * PIN_FORCE_SIZE)
        for j in range(np.uintp(wheel.n_lobes + 1)):
            external[w, j, 0] = on_pins[first + P_FORCE + j]
            external[w, j, 1] = on_pins[first + P_X + j]
            external[w, j, 2] = on_pins[first + P_Y + j]
        cos_phi, sin_phi = np.cos(phi), np.sin(phi)
        _joint_vectors(
            w, joint, sleeves, on_sleeves,
            mounts[own + rows.CAM_X] * cos_phi - mounts[own + rows.CAM_Y] * sin_phi,
            mounts[own + rows.CAM_X] * sin_phi + mounts[own + rows.CAM_Y] * cos_phi,
            np.cos(state[2] - phi / z), np.sin(state[2] - phi / z),
            np.cos(state[w] - phi / z), np.sin(state[w] - phi / z),
        )  # fmt: skip
        first = np.uintp(w * JOINT_SIZE)
        for k in range(np.uintp(joint.n_sleeves)):
            internal[w, k, 0] = on_sleeves[first + S_FORCE + k]
            internal[w, k, 1] = on_sleeves[first + S_X + k]
            internal[w, k, 2] = on_sleeves[first + S_Y + k]


def new_memory(state: NDArray[np.float64]) -> tuple[NDArray[Any], ...]:
    """Working memory of :func:`derivatives` for states like ``state``, with nothing described yet."""
    return (
        np.full(rows.WHEEL_TABLE_SIZE, np.inf), np.zeros(rows.WHEEL_TABLE_SIZE, dtype=np.uintp),
        np.zeros(rows.FEET_SIZE), np.zeros(2 * rows.FLANK_SIZE), np.zeros(2 * rows.EDGE_SIZE),
        np.zeros(2 * JOINT_SIZE), np.zeros(2 * PIN_FORCE_SIZE), np.zeros(state.size - N_STATE),
    )  # fmt: skip


@njit(fastmath=FASTMATH, inline="always")
def _turn_by(cosine, sine, angle):
    """Rotate (cosine, sine) by a small angle and pull the result back onto the unit circle."""
    s, c = small_sincos(angle)
    x, y = cosine * c - sine * s, sine * c + cosine * s
    scale = 1.5 - 0.5 * (x * x + y * y)
    return x * scale, y * scale


# Steps between two exact evaluations of the driver's sines; turning by polynomials in between is cheaper.
RESYNC = 128


@njit(fastmath=FASTMATH, nogil=True)
def integrate(
    stages, n_steps, dt, phi, omega, alpha, load, state, wheel, joint, contact, joint_contact, body, friction,
    pins, mounts, lobes, wear, sleeves, memory, limit, locked_torque, locked_steps, result, kept, motion,
    external, internal, last_external, last_internal,
):  # fmt: skip
    """Integrate over ``n_steps`` steps.

    In two ``stages`` by the midpoint rule (second-order Runge-Kutta), in one by the second-order
    Adams-Bashforth rule.

    ``phi``, ``omega``, ``alpha``, ``load`` hold the driver and load at every half step: (2 n_steps + 1,).
    ``memory`` comes from :func:`new_memory`. ``result`` is (n_steps, 2). ``kept`` (n_kept,) lists the steps,
    rising, whose state goes into ``motion`` (n_kept, 8 or more) and whose forces into ``external`` (n_kept or
    0, 2, n_pins, 3) and ``internal`` (n_kept or 0, 2, n_internal, 3). Returns the number of finished steps:
    fewer than ``n_steps`` where a torque exceeded ``limit`` or was not a number, or the input torque
    ``locked_torque`` for more than ``locked_steps`` steps; ``last_external`` and ``last_internal`` then hold
    the last forces.
    """
    z = float(wheel.n_lobes)
    n_state = state.size
    rates = np.zeros(n_state)
    last_rates = np.zeros(n_state)
    at = state.copy()
    now = np.zeros(N_RESULT)
    machine = (wheel, joint, contact, joint_contact, body, *addresses((pins, mounts, lobes, wear, sleeves)))
    memory = addresses(memory)
    at_first, rates_first, now_first = addresses((at, rates, now))
    cos_phi, sin_phi = 1.0, 0.0
    cos_slow, sin_slow = 1.0, 0.0
    row = 0
    locked = 0
    stride = 2 // stages
    # One call of derivatives for both halves of a step: the loop fits the processor's instruction cache.
    for m in range(stages * n_steps):
        i = m * stride
        step = i // 2
        if i % (2 * RESYNC) == 0:
            cos_phi, sin_phi = np.cos(phi[i]), np.sin(phi[i])
            cos_slow, sin_slow = np.cos(phi[i] / z), -np.sin(phi[i] / z)
        else:
            turn = phi[i] - phi[i - stride]
            cos_phi, sin_phi = _turn_by(cos_phi, sin_phi, turn)
            cos_slow, sin_slow = _turn_by(cos_slow, sin_slow, -turn / z)
        derivatives(
            phi[i], cos_phi, sin_phi, cos_slow, sin_slow, omega[i], alpha[i], load[i], at_first, machine,
            friction, memory, rates_first, now_first,
        )  # fmt: skip
        if i % 2 == 1:
            for k in range(n_state):
                state[k] += dt * rates[k]
                at[k] = state[k]
            continue
        result[step, 0] = now[0]
        result[step, 1] = now[1]
        if row < kept.size and step == kept[row]:
            for k in range(motion.shape[1]):
                motion[row, k] = state[k]
            if row < external.shape[0]:
                gather(wheel, joint, mounts, sleeves, memory, phi[i], state, external[row], internal[row])
            row += 1
        locked = locked + 1 if abs(now[1]) > locked_torque else 0
        if locked > locked_steps or not (abs(now[0]) < limit and abs(now[1]) < limit):
            gather(wheel, joint, mounts, sleeves, memory, phi[i], state, last_external, last_internal)
            return step
        if stages == 2:
            for k in range(n_state):
                at[k] = state[k] + 0.5 * dt * rates[k]
        else:
            # The drive's acceleration jumps where a ramp ends: take its part from the speed instead.
            n_driven = 8 if body.brake_inertia > 0.0 else 7
            for k in range(4, n_driven):
                rates[k] -= alpha[i] / z
                state[k] += (omega[i + 2] - omega[i]) / z
            # The first step has no earlier rates: Euler's rule, of second order in one step.
            share = 0.5 if m > 0 else 0.0
            for k in range(n_state):
                state[k] += dt * ((1.0 + share) * rates[k] - share * last_rates[k])
                at[k] = state[k]
                last_rates[k] = rates[k]
    return n_steps


@njit(fastmath=FASTMATH, nogil=True)
def integrate_held(
    n_steps, dt, torque, phi, damping, input_inertia, through_meter, state, wheel, joint, contact,
    joint_contact, body, friction, pins, mounts, lobes, wear, sleeves, memory, limit, every, angle, held,
):  # fmt: skip
    """Midpoint rule over ``n_steps`` steps with the output held and the input driven by a torque.

    ``torque`` (2 n_steps + 1,) is the input torque at half steps; every ``every``-th step records the input
    angle in ``angle`` and the output torque in ``held``. Returns the number of finished steps.
    """
    n_state = state.size
    rates, result, at = np.zeros(n_state), np.zeros(N_RESULT), state.copy()
    inertia = input_inertia
    for w in range(2):
        own = np.uintp(w * rows.COLUMNS)
        inertia += body.wheel_mass * (mounts[own + rows.CAM_X] ** 2 + mounts[own + rows.CAM_Y] ** 2)
    machine = (wheel, joint, contact, joint_contact, body, *addresses((pins, mounts, lobes, wear, sleeves)))
    memory = addresses(memory)
    z = float(wheel.n_lobes)
    omega = 0.0
    at_phi, at_omega = phi, omega
    # One call of the derivatives for both halves of a step keeps the code short.
    for m in range(2 * n_steps):
        step = m // 2
        # With alpha = 0 the kernel's input torque is the torque of contacts and bearing on the drive.
        derivatives(
            at_phi, np.cos(at_phi), np.sin(at_phi), np.cos(at_phi / z), -np.sin(at_phi / z), at_omega, 0.0,
            0.0, at, machine, friction, memory, rates, result,
        )  # fmt: skip
        alpha = (torque[m] - damping * at_omega - result[1]) / inertia
        # Deviations are relative to the rest position, which follows the input; the held body is at rest.
        if through_meter:
            rates[7] = 0.0
        else:
            rates[6] = 0.0
        for k in range(4):
            rates[4 + k] += alpha / z
        if m % 2 == 0:
            if step % every == 0:
                angle[step // every] = phi
                held[step // every] = result[0]
            if not (abs(result[0]) < limit and abs(result[1]) < limit):
                return step
            for k in range(n_state):
                at[k] = state[k] + 0.5 * dt * rates[k]
            at_phi = phi + 0.5 * dt * omega
            at_omega = omega + 0.5 * dt * alpha
        else:
            for k in range(n_state):
                state[k] += dt * rates[k]
                at[k] = state[k]
            phi += dt * at_omega
            omega += dt * alpha
            at_phi, at_omega = phi, omega
    return n_steps
