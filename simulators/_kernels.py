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
OUTLINE_CHECKSUM = 0x6C590C71

# In the order of the gearbox's ``CONTACT_LAWS``.
PAPER_LAW, HUNT_CROSSLEY_LAW, CONSERVATIVE_LAW = range(3)

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
# Rows for all sleeves of a kind on one wheel: force, its vector on the wheel in the fixed frame, and with
# friction their axles and the vectors that press on these. External sleeves come first, on both wheels.
FORCE, PUSH_X, PUSH_Y, AXLE_X, AXLE_Y, LOAD_X, LOAD_Y = (np.uintp(row * rows.COLUMNS) for row in range(7))
SLEEVES_SIZE = 7 * rows.COLUMNS

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
        carried[first + FORCE + k] = f
        over = f * inverse
        sum_0 += over
        sum_c += over * ca
        sum_s += over * sa
    on_cam = sum_c * way_c + sum_s * way_s
    on_wheel = lever * sum_0 - (hole_c * sum_c + hole_s * sum_s)
    on_output = out_c * sum_c + out_s * sum_s - lever * sum_0
    return -on_cam, on_wheel, on_output


@njit(fastmath=FASTMATH)
def _gather_joint_forces(w, joint, sleeves, carried, cx, cy, cos_out, sin_out, cos_hole, sin_hole):
    """Write axles and vectors on wheel ``w`` of the forces that the internal sleeves carry."""
    first = np.uintp((2 + w) * SLEEVES_SIZE)
    r = joint.pitch_radius
    sx, sy = r * (cos_out - cos_hole), r * (sin_out - sin_hole)
    for k in range(np.uintp(joint.n_sleeves)):
        ca, sa = sleeves[SLEEVE_COS + k], sleeves[SLEEVE_SIN + k]
        dx, dy = ca * sx - sa * sy - cx, sa * sx + ca * sy - cy
        over = carried[first + FORCE + k] / np.sqrt(dx * dx + dy * dy)
        carried[first + PUSH_X + k] = over * dx
        carried[first + PUSH_Y + k] = over * dy
        carried[first + AXLE_X + k] = r * (ca * cos_out - sa * sin_out)
        carried[first + AXLE_Y + k] = r * (sa * cos_out + ca * sin_out)


@njit(fastmath=FASTMATH, inline="always")
def _add_pin_force(carried, j, force, along, tilt, nx, ny, turned_cos, turned_sin):
    """Add the force of one contact along its direction, given by its normal, to its pin."""
    fx, fy = force * (along * nx - tilt * ny), force * (along * ny + tilt * nx)
    carried[FORCE + j] += force
    carried[PUSH_X + j] -= turned_cos * fx - turned_sin * fy
    carried[PUSH_Y + j] -= turned_sin * fx + turned_cos * fy


@njit(fastmath=FASTMATH)
def _gather_pin_forces(w, counts, flanks, edges, turned_cos, turned_sin, wheel, pins, carried):
    """Write axle and force of every pin on wheel ``w``: magnitudes added, and the vector on the wheel."""
    own = np.uintp(w * rows.COLUMNS)
    first = np.uintp(w * SLEEVES_SIZE)
    for j in range(np.uintp(wheel.n_lobes + 1)):
        radial = wheel.pin_circle_radius + pins[rows.PIN_RADIAL_ERROR + j]
        c, s, tangential = pins[rows.PIN_COS + j], pins[rows.PIN_SIN + j], pins[rows.PIN_TANGENTIAL_ERROR + j]
        carried[first + AXLE_X + j] = c * radial - s * tangential
        carried[first + AXLE_Y + j] = s * radial + c * tangential
        carried[first + FORCE + j] = 0.0
        carried[first + PUSH_X + j] = 0.0
        carried[first + PUSH_Y + j] = 0.0
    for i in range(counts[own + rows.USED_FLANKS]):
        k = np.uintp(w * rows.FLANK_SIZE) + i
        tilt = flanks[rows.F_TILT + k]
        _add_pin_force(
            carried, first + np.uintp(flanks[rows.F_PIN + k]), flanks[rows.F_FORCE + k],
            1.0 - 0.5 * tilt * tilt, tilt, flanks[rows.F_NX + k], flanks[rows.F_NY + k], turned_cos,
            turned_sin,
        )  # fmt: skip
    for i in range(counts[own + rows.USED_EDGES]):
        k = np.uintp(w * rows.EDGE_SIZE) + i
        _add_pin_force(
            carried, first + np.uintp(edges[rows.E_PIN + k]), edges[rows.E_FORCE + k],
            edges[rows.E_ALONG + k], edges[rows.E_TILT + k], edges[rows.E_NX + k], edges[rows.E_NY + k],
            turned_cos, turned_sin,
        )  # fmt: skip


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
def _rub_sleeves(first, n, spins, radius, carrier, friction, carried, cx, cy, omega, rate, state, torques):
    """Friction of all sleeves of a kind on one wheel: moments of the cam, on the wheel and on the carrier.

    ``spins`` is the place of the first sleeve's spin in the state, ``carrier`` the rate of the body on which
    the axles sit. A pin that touches twice rubs where the resultant acts.
    """
    total_x, total_y = 0.0, 0.0
    moment, on_carrier = 0.0, 0.0
    for k in range(np.uintp(n)):
        fx, fy = carried[first + PUSH_X + k], carried[first + PUSH_Y + k]
        carried[first + LOAD_X + k] = fx
        carried[first + LOAD_Y + k] = fy
        force = np.sqrt(fx * fx + fy * fy)
        if force == 0.0:
            continue
        nx, ny = fx / force, fy / force
        sx, sy = carried[first + AXLE_X + k], carried[first + AXLE_Y + k]
        lever = (sx + radius * nx - cx) * nx + (sy + radius * ny - cy) * ny
        axle = sx * nx + sy * ny
        # Wheel minus sleeve at the contact, along n turned by a quarter turn.
        slip = omega * (cx * nx + cy * ny) + rate * lever - carrier * axle - state[spins + k] * radius
        rub = _sleeve_friction(slip, force, friction)
        total_x += rub * ny
        total_y -= rub * nx
        moment -= rub * lever
        on_carrier += rub * axle
        torques[spins - np.uintp(N_STATE) + k] += radius * rub
        carried[first + LOAD_X + k] += rub * ny
        carried[first + LOAD_Y + k] -= rub * nx
    return cx * total_y - cy * total_x, moment, on_carrier


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
    seen, counts, feet, flanks, edges, carried, torques = memory
    z = float(wheel.n_lobes)
    mean_rate = -omega / z
    mean_acceleration = -alpha / z
    out_sin, out_cos = small_sincos(state[2])
    cos_out, sin_out = cos_slow * out_cos - sin_slow * out_sin, sin_slow * out_cos + cos_slow * out_sin
    rate_out = mean_rate + state[6]
    moment_out = 0.0
    torque_in = 0.0
    pin_spins = np.uintp(N_STATE)
    joint_spins = pin_spins + np.uintp(wheel.n_lobes + 1)
    if friction is not None:
        for k in range(np.uintp(wheel.n_lobes + 1 + joint.n_sleeves)):
            torques[k] = 0.0
    for w in range(2):
        own = np.uintp(w * rows.COLUMNS)
        side = 1.0 - 2.0 * w
        eps = state[w]
        cx = mounts[own + rows.CAM_X] * cos_phi - mounts[own + rows.CAM_Y] * sin_phi
        cy = mounts[own + rows.CAM_X] * sin_phi + mounts[own + rows.CAM_Y] * cos_phi
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
            np.uintp((2 + w) * SLEEVES_SIZE), joint, joint_contact, sleeves, carried, cx, cy, omega, cos_out,
            sin_out, cos_hole, sin_hole, rate_out, rate,
        )  # fmt: skip
        on_cam += joint_on_cam
        moment += joint_moment
        moment_out += on_output
        if friction is not None:
            _gather_pin_forces(w, counts, flanks, edges, ct, st, wheel, pins, carried)
            _gather_joint_forces(w, joint, sleeves, carried, cx, cy, cos_out, sin_out, cos_hole, sin_hole)
            pins_on_cam, by_pins, _ = _rub_sleeves(
                np.uintp(w * SLEEVES_SIZE), wheel.n_lobes + 1, pin_spins, wheel.pin_radius, 0.0, friction,
                carried, cx, cy, omega, rate, state, torques,
            )  # fmt: skip
            joints_on_cam, by_joints, on_output = _rub_sleeves(
                np.uintp((2 + w) * SLEEVES_SIZE), joint.n_sleeves, joint_spins, joint.sleeve_radius, rate_out,
                friction, carried, cx, cy, omega, rate, state, torques,
            )  # fmt: skip
            on_cam += pins_on_cam + joints_on_cam
            moment += by_pins + by_joints
            moment_out += on_output
        rates[w] = state[4 + w]
        rates[4 + w] = moment / body.wheel_inertia - mean_acceleration
        # Moment about the input shaft of the cam's force on the wheel.
        torque_in += body.wheel_mass * alpha * (cx * cx + cy * cy) - on_cam
    if friction is not None:
        _spin_sleeves(
            0, wheel.n_lobes + 1, pin_spins, wheel.pin_radius, 0.0, friction, carried, state, torques, rates
        )
        moment_out += _spin_sleeves(
            2, joint.n_sleeves, joint_spins, joint.sleeve_radius, rate_out, friction, carried, state, torques,
            rates,
        )  # fmt: skip
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
def _spin_sleeves(kind, n, spins, radius, carrier, friction, carried, state, torques, rates):
    """Rates of the spin of all sleeves of a kind on their axles; return the moment on the axles' carrier."""
    first, second = np.uintp(kind * SLEEVES_SIZE), np.uintp((kind + 1) * SLEEVES_SIZE)
    on_carrier = 0.0
    for k in range(np.uintp(n)):
        fx = carried[first + LOAD_X + k] + carried[second + LOAD_X + k]
        fy = carried[first + LOAD_Y + k] + carried[second + LOAD_Y + k]
        grip = friction.journal_friction * radius * np.sqrt(fx * fx + fy * fy)
        drag = grip * np.tanh((state[spins + k] - carrier) * radius / friction.friction_transition_speed)
        rates[spins + k] = (torques[spins - np.uintp(N_STATE) + k] - drag) / friction.sleeve_inertia
        on_carrier += drag
    return on_carrier


@njit(fastmath=FASTMATH)
def gather(machine, memory, phi, state, external, internal):
    """Forces of all sleeves at the last evaluation: (2, n_sleeves, 3), magnitude and vector on the wheel."""
    wheel, joint, _, _, _, pins, mounts, _, _, sleeves = machine
    seen, counts, _, flanks, edges, carried, _ = memory
    z = float(wheel.n_lobes)
    cos_phi, sin_phi = np.cos(phi), np.sin(phi)
    for w in range(2):
        own = np.uintp(w * rows.COLUMNS)
        st, ct = small_sincos(state[w] - seen[own + rows.SEEN_EPS] - (phi - seen[own + rows.SEEN_PHI]) / z)
        _gather_pin_forces(w, counts, flanks, edges, ct, st, wheel, pins, carried)
        _gather_joint_forces(
            w, joint, sleeves, carried,
            mounts[own + rows.CAM_X] * cos_phi - mounts[own + rows.CAM_Y] * sin_phi,
            mounts[own + rows.CAM_X] * sin_phi + mounts[own + rows.CAM_Y] * cos_phi,
            np.cos(state[2] - phi / z), np.sin(state[2] - phi / z),
            np.cos(state[w] - phi / z), np.sin(state[w] - phi / z),
        )  # fmt: skip
        for kind, forces in enumerate((external[w], internal[w])):
            for k in range(forces.shape[0]):
                for row in range(3):
                    place = (2 * kind + w) * SLEEVES_SIZE + row * rows.COLUMNS + k
                    forces[k, row] = carried[np.uintp(place)]


def new_memory(state: NDArray[np.float64]) -> tuple[NDArray[Any], ...]:
    """Working memory of :func:`derivatives` for states like ``state``, with nothing described yet."""
    return (
        np.full(rows.WHEEL_TABLE_SIZE, np.inf), np.zeros(rows.WHEEL_TABLE_SIZE, dtype=np.uintp),
        np.zeros(rows.FEET_SIZE), np.zeros(2 * rows.FLANK_SIZE), np.zeros(2 * rows.EDGE_SIZE),
        np.zeros(4 * SLEEVES_SIZE), np.zeros(state.size - N_STATE),
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
    external, internal,
):  # fmt: skip
    """Integrate over ``n_steps`` steps.

    In two ``stages`` by the midpoint rule (second-order Runge-Kutta), in one by the second-order
    Adams-Bashforth rule.

    ``phi``, ``omega``, ``alpha``, ``load`` hold the driver and load at every half step: (2 n_steps + 1,).
    ``memory`` comes from :func:`new_memory`. ``result`` is (n_steps, 2). ``kept`` (n_kept,) lists the steps,
    rising, whose state goes into ``motion`` (n_kept, 8 or more) and whose forces into ``external`` and
    ``internal`` (n_kept + 1 or 1, 2, n_sleeves, 3). Returns the number of finished steps: fewer than
    ``n_steps`` where a torque exceeded ``limit`` or was not a number, or the input torque ``locked_torque``
    for more than ``locked_steps`` steps; the last rows of the forces are then those of that step.
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
            if row < external.shape[0] - 1:
                gather(machine, memory, phi[i], state, external[row], internal[row])
            row += 1
        locked = locked + 1 if abs(now[1]) > locked_torque else 0
        if locked > locked_steps or not (abs(now[0]) < limit and abs(now[1]) < limit):
            gather(machine, memory, phi[i], state, external[-1], internal[-1])
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
