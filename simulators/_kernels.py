"""The reduced gearbox model in numba: floats and arrays only.

State of one gearbox, all as deviations from the rest position that follows the input angle phi:

====  =====================================  =======================================
0     eps_1 = theta_1 + (phi + pi)/z_s       wheel 1
1     eps_2 = theta_2 + phi/z_s - rest_2     wheel 2
2     eps_out = psi + phi/z_s                output shaft
3     eps_brake = psi_b + phi/z_s            rotor of the brake, behind the torque meter
4-7   their rates
====  =====================================  =======================================

The deviations are small (contact penetration over radius), so the sines and cosines of the moving parts
follow from those of phi and phi/z_s by short polynomials.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from cyclofeat.simulators._jit import njit

PAPER_LAW = 0
HUNT_CROSSLEY_LAW = 1
CONSERVATIVE_LAW = 2

# Entry of the lobe table for a removed lobe; 0 is healthy, up to 1 the share of the width that is worn.
REMOVED = 2.0

# Reassociation lets the sums over the pins use vector instructions. Infinities and NaN keep their meaning:
# divergence is found by looking for them.
FASTMATH = {"reassoc", "contract", "arcp", "nsz"}

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

WheelConstants = namedtuple(
    "WheelConstants",
    [
        "eccentricity",  # m
        "shortening",
        "n_lobes",
        "pin_radius",  # m
        "pin_circle_radius",  # m
        "tip_x",  # tip of lobe 0, on the x axis, m
        "pit_x",  # pit of lobe 0, m
        "pit_y",
        "pit_nx",  # outward unit normal of the profile at the pit
        "pit_ny",
        "tip_radius",  # effective contact radius at the tip, m
        "pit_radius",  # and at the pit, m
        "near",  # square of the displacement up to which one Newton step finds the foot of every pin, m^2
    ],
)

JointConstants = namedtuple(
    "JointConstants",
    [
        "pitch_radius",  # of the internal sleeves, m
        "gap_at_centre",  # hole radius minus sleeve radius, m
    ],
)

BodyConstants = namedtuple(
    "BodyConstants",
    [
        "wheel_mass",
        "wheel_inertia",
        "output_inertia",
        "brake_inertia",  # 0: the load acts on the output shaft itself
        "meter_stiffness",
        "meter_damping",
    ],
)

# Tables with one column per pin are flat arrays of rows of this fixed length, indexed without a sign: the
# compiler then sees that their rows do not overlap, which it must know before it uses vector instructions.
MAX_PINS = 128
# Rows of the table of pins ...
PIN_COS, PIN_SIN, PIN_RADIAL_ERROR, PIN_TANGENTIAL_ERROR, PIN_ANGLE = (
    np.uintp(row * MAX_PINS) for row in range(5)
)
PIN_TABLE_SIZE = 5 * MAX_PINS
# ... and of the working memory of one wheel: share of the healthy profile under each pin, force on each pin.
WEIGHT, FORCE = (np.uintp(row * MAX_PINS) for row in range(2))
WORK_SIZE = 2 * MAX_PINS
# Columns of the table of mounts, shape (2 wheels, 6), and rows of the lobes' directions, shape (2, n_lobes).
REST_ANGLE, REST_COS, REST_SIN, RUNOUT_X, RUNOUT_Y, FAULT_KIND = range(6)
LOBE_COS, LOBE_SIN = range(2)
# Entries of FAULT_KIND: bits.
HAS_WORN, HAS_REMOVED = 1, 2

# A pin counts to a lobe from this share of the lobe's pitch before its tip: the foot on the profile may lie
# a little ahead of the pin's rest position.
LEAD = 0.06

# Largest step of the foot along the profile in rad of its parameter: a pin that wants more is far from
# touching, and up to here the polynomials below are exact to rounding.
LARGEST_STEP = 0.03

N_STATE = 8
N_RESULT = 2  # torque_out, torque_in


@njit(fastmath=FASTMATH, inline="always")
def small_sincos(x):
    """Sine and cosine; polynomials (rounding only) for |x| < 0.7, the library beyond."""
    if abs(x) > 0.7:
        return np.sin(x), np.cos(x)
    y = x * x
    sine = x * (
        1.0
        - y
        / 6.0
        * (1.0 - y / 20.0 * (1.0 - y / 42.0 * (1.0 - y / 72.0 * (1.0 - y / 110.0 * (1.0 - y / 156.0)))))
    )
    cosine = 1.0 - y / 2.0 * (
        1.0
        - y
        / 12.0
        * (1.0 - y / 30.0 * (1.0 - y / 56.0 * (1.0 - y / 90.0 * (1.0 - y / 132.0 * (1.0 - y / 182.0)))))
    )
    return sine, cosine


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


@njit(fastmath=FASTMATH)
def _profile_contacts(
    wheel, contact, pins, work, cx, cy, cvx, cvy, offset_x, offset_y, lobe_cos, lobe_sin, rate
):
    """Contacts of all pins with the healthy profile of one wheel: a branch-free loop over the pins.

    Every pin is treated in its own frame (radial, tangential). ``c`` is the cam's centre and ``cv`` its
    velocity, ``offset`` the vector from the foot at rest to the pin's centre, which is the same for all
    pins, ``lobe`` = exp(-i z_s theta). Adds the forces to ``work`` and returns the force on the wheel and
    its moment about the cam.
    """
    eccentricity = wheel.eccentricity
    inverse_m = 1.0 / wheel.shortening
    n_lobes = float(wheel.n_lobes)
    n_pins = n_lobes + 1.0
    q = wheel.pin_radius
    big_r = wheel.pin_circle_radius
    inverse_ez = 1.0 / (eccentricity * n_pins)
    # With cos(z_s t)/m = (|g|^2 - 1 - 1/m^2)/2 the curvature is curve_1/|g| + curve_3/|g|^3; its change along
    # the trochoid follows from d|g|/dt = -z_s sin(z_s t)/(m |g|).
    curve_1 = inverse_ez * (1.0 + 0.5 * n_lobes)
    curve_3 = inverse_ez * 0.5 * n_lobes * (1.0 - inverse_m * inverse_m)
    steepness = n_lobes * inverse_m * inverse_ez
    pit = 1.0 / (inverse_m - 1.0)
    largest_change = 0.25 * abs((curve_1 + curve_3 * pit * pit) * pit)
    total_x = 0.0
    total_y = 0.0
    moment = 0.0
    for j in range(np.uintp(wheel.n_lobes + 1)):
        cb = pins[PIN_COS + j]
        sb = pins[PIN_SIN + j]
        dx = cb * offset_x + sb * offset_y + pins[PIN_RADIAL_ERROR + j]
        dy = cb * offset_y - sb * offset_x + pins[PIN_TANGENTIAL_ERROR + j]
        # First guess: the foot of the rest position, where exp(i z_s t) = exp(-i beta) exp(-i z_s theta).
        qx = cb * lobe_cos + sb * lobe_sin
        qy = cb * lobe_sin - sb * lobe_cos
        gx = inverse_m + qx
        # One Newton step along the tangent, by small-angle polynomials of exp(i step) and exp(i z_k step).
        step = (dy * gx - dx * qy) * inverse_ez / (gx * gx + qy * qy)
        step = min(max(step, -LARGEST_STEP), LARGEST_STEP)
        y = step * step
        s1 = step * (1.0 - y / 6.0 * (1.0 - y / 20.0))
        v1 = y / 2.0 * (1.0 - y / 12.0 * (1.0 - y / 30.0))  # 1 - cos
        x = n_pins * step
        y = x * x
        s2 = x * (1.0 - y / 6.0 * (1.0 - y / 20.0 * (1.0 - y / 42.0 * (1.0 - y / 72.0))))
        v2 = y / 2.0 * (1.0 - y / 12.0 * (1.0 - y / 30.0 * (1.0 - y / 56.0 * (1.0 - y / 90.0))))
        # Vector from the new foot to the pin's centre.
        rx = dx + big_r * v1 + eccentricity * (qx * v2 + qy * s2)
        ry = dy - big_r * s1 + eccentricity * (qy * v2 - qx * s2)
        # exp(i step) g(t) = exp(i step)/m + exp(i z_k step) exp(i z_s t0)
        hx = (1.0 - v1) * inverse_m + (1.0 - v2) * qx - s2 * qy
        hy = s1 * inverse_m + (1.0 - v2) * qy + s2 * qx
        gg = hx * hx + hy * hy
        ig = 1.0 / np.sqrt(gg)
        nx = hx * ig
        ny = hy * ig
        cubic = curve_3 * ig * ig
        kappa = (curve_1 + cubic) * ig
        normal_part = rx * nx + ry * ny
        tangential_part = ry * nx - rx * ny
        # What is left of the tangential part is taken on the osculating circle, with the change of curvature
        # along it: near the pit it is so fast that the forces depend on it.
        rest = tangential_part / max(1.0 + kappa * normal_part, 0.3)
        sine_lobe = (1.0 - v1) * hy - s1 * hx
        change = (curve_1 + 3.0 * cubic) * (ig * ig) * (ig * ig) * steepness * sine_lobe * rest
        change = min(max(change, -largest_change), largest_change)
        bend = kappa * rest
        gap = normal_part + 0.5 * bend * tangential_part + change * rest * rest / 6.0
        bend += 0.5 * change * rest
        kappa += change
        shrink = 1.0 - 0.5 * bend * bend
        mx = shrink * nx - bend * ny
        my = shrink * ny + bend * nx
        px = big_r + pins[PIN_RADIAL_ERROR + j] - (cb * cx + sb * cy)
        py = pins[PIN_TANGENTIAL_ERROR + j] - (cb * cy - sb * cx)
        arm = px * my - py * mx
        gap_rate = -(mx * (cb * cvx + sb * cvy) + my * (cb * cvy - sb * cvx)) - rate * arm
        radius = max(q * (1.0 - kappa * q), 0.0)
        f = work[WEIGHT + j] * contact_force(-gap, -gap_rate, radius, contact)
        work[FORCE + j] += f
        total_x -= f * (cb * mx - sb * my)
        total_y -= f * (sb * mx + cb * my)
        moment -= f * arm
    return total_x, total_y, moment


# Search for the foot of a far displaced pin: half width (in half pitches of the lobes) and number of points
# of the first grid, and the largest number of steps after it.
SEARCH_WIDTH, SEARCH_POINTS, SEARCH_STEPS = 0.75, 33, 24


@njit(fastmath=FASTMATH)
def _far_profile_contacts(
    wheel, contact, pins, work, cx, cy, cvx, cvy, offset_x, offset_y, lobe_cos, lobe_sin, rate
):
    """As :func:`_profile_contacts`, exact and slow: for pins displaced by the trochoid's radius at the pit.

    So far the output slips where lobes of both wheels have been removed.
    """
    eccentricity = wheel.eccentricity
    inverse_m = 1.0 / wheel.shortening
    n_lobes = float(wheel.n_lobes)
    n_pins = n_lobes + 1.0
    q = wheel.pin_radius
    big_r = wheel.pin_circle_radius
    inverse_ez = 1.0 / (eccentricity * n_pins)
    width = SEARCH_WIDTH * np.pi / n_lobes
    spacing = 2.0 * width / (SEARCH_POINTS - 1)
    cos_first = np.cos(width)
    sin_first = np.sin(width)
    cos_lobe_first = np.cos(n_pins * width)
    sin_lobe_first = np.sin(n_pins * width)
    cos_spacing = np.cos(spacing)
    sin_spacing = np.sin(spacing)
    cos_lobe_spacing = np.cos(n_pins * spacing)
    sin_lobe_spacing = np.sin(n_pins * spacing)
    total_x = 0.0
    total_y = 0.0
    moment = 0.0
    for j in range(np.uintp(wheel.n_lobes + 1)):
        if work[WEIGHT + j] == 0.0:
            continue
        cb = pins[PIN_COS + j]
        sb = pins[PIN_SIN + j]
        # Pin and foot in the frame of the pin; there the trochoid at the rest position's parameter is x = 0.
        dx = cb * offset_x + sb * offset_y + pins[PIN_RADIAL_ERROR + j]
        dy = cb * offset_y - sb * offset_x + pins[PIN_TANGENTIAL_ERROR + j]
        qx = cb * lobe_cos + sb * lobe_sin
        qy = cb * lobe_sin - sb * lobe_cos
        best = -width
        nearest = np.inf
        ux = cos_first
        uy = -sin_first
        wx = cos_lobe_first * qx + sin_lobe_first * qy
        wy = cos_lobe_first * qy - sin_lobe_first * qx
        for k in range(SEARCH_POINTS):
            rx = dx + big_r * (1.0 - ux) + eccentricity * (qx - wx)
            ry = dy - big_r * uy + eccentricity * (qy - wy)
            distance = rx * rx + ry * ry
            if distance < nearest:
                nearest = distance
                best = k * spacing - width
            ux, uy = ux * cos_spacing - uy * sin_spacing, uy * cos_spacing + ux * sin_spacing
            wx, wy = (
                wx * cos_lobe_spacing - wy * sin_lobe_spacing,
                wy * cos_lobe_spacing + wx * sin_lobe_spacing,
            )
        # Newton steps, kept inside a bracket that shrinks.
        low = best - spacing
        high = best + spacing
        step = best
        for _ in range(SEARCH_STEPS):
            ux = np.cos(step)
            uy = np.sin(step)
            wx = np.cos(n_pins * step) * qx - np.sin(n_pins * step) * qy
            wy = np.cos(n_pins * step) * qy + np.sin(n_pins * step) * qx
            rx = dx + big_r * (1.0 - ux) + eccentricity * (qx - wx)
            ry = dy - big_r * uy + eccentricity * (qy - wy)
            hx = ux * inverse_m + wx
            hy = uy * inverse_m + wy
            ahead = (ry * hx - rx * hy) * inverse_ez
            slope = hx * hx + hy * hy + (rx * (hx + n_lobes * wx) + ry * (hy + n_lobes * wy)) * inverse_ez
            if ahead > 0.0:
                low = step
            else:
                high = step
            following = step + ahead / slope if slope > 0.0 else high + 1.0
            if following <= low or following >= high:
                following = 0.5 * (low + high)
            change = abs(following - step)
            step = following
            if change < 1e-12:
                break
        ig = 1.0 / np.sqrt(hx * hx + hy * hy)
        nx = hx * ig
        ny = hy * ig
        cos_lobe = ux * wx + uy * wy
        kappa = (1.0 + n_lobes * (1.0 + cos_lobe * inverse_m) * ig * ig) * ig * inverse_ez
        gap = rx * nx + ry * ny
        px = big_r + pins[PIN_RADIAL_ERROR + j] - (cb * cx + sb * cy)
        py = pins[PIN_TANGENTIAL_ERROR + j] - (cb * cy - sb * cx)
        arm = px * ny - py * nx
        gap_rate = -(nx * (cb * cvx + sb * cvy) + ny * (cb * cvy - sb * cvx)) - rate * arm
        f = work[WEIGHT + j] * contact_force(-gap, -gap_rate, max(q * (1.0 - kappa * q), 0.0), contact)
        work[FORCE + j] += f
        work[WEIGHT + j] = 0.0
        total_x -= f * (cb * nx - sb * ny)
        total_y -= f * (sb * nx + cb * ny)
        moment -= f * arm
    return total_x, total_y, moment


@njit(fastmath=FASTMATH)
def _worn_contacts(w, wheel, contact, pins, wear, work, run_x, run_y, theta, cx, cy, cvx, cvy, rate):
    """Contacts of all pins with the chords of the worn lobes of wheel ``w``.

    The outline is one closed curve: a pin rests on the tip's vertex before it lies on the chord, and at the
    re-entrant pit it touches chord and flank at once; the flank ends there in a point of its own. ``run``
    is the runout in the fixed frame. Writes into ``work`` how much of the healthy profile is left under
    each pin, adds the forces, and returns the force on the wheel and its moment.
    """
    n_lobes = wheel.n_lobes
    lobe_pitch = 2.0 * np.pi / n_lobes
    q = wheel.pin_radius
    tip = wheel.tip_x
    length = np.sqrt((wheel.pit_x - tip) ** 2 + wheel.pit_y**2)
    ux = (wheel.pit_x - tip) / length
    uy = wheel.pit_y / length
    # Outward normal of the chord.
    ox = uy
    oy = -ux
    inverse_oy = 1.0 / oy
    lobes_per_radian = 1.0 / lobe_pitch
    total_x = 0.0
    total_y = 0.0
    moment = 0.0
    first = n_lobes * np.floor((LEAD - theta * lobes_per_radian) / n_lobes)
    # Table look-ups have a loop of their own: they would keep the next one from using vector instructions.
    for j in range(np.uintp(wheel.n_lobes + 1)):
        lobe = int(np.floor((pins[PIN_ANGLE + j] - theta) * lobes_per_radian + LEAD) - first)
        if lobe >= n_lobes:
            lobe -= n_lobes
        share = wear[w, min(max(lobe, 0), n_lobes - 1)]  # an angle that is not a number gives any index
        work[WEIGHT + j] = 0.0 if share == REMOVED else share
    for j in range(np.uintp(wheel.n_lobes + 1)):
        cb = pins[PIN_COS + j]
        sb = pins[PIN_SIN + j]
        # Angle of the pin past the tip of the lobe under it, and its sine and cosine.
        turns = (pins[PIN_ANGLE + j] - theta) * lobes_per_radian + LEAD
        part = turns - np.floor(turns)
        x = (part - LEAD) * lobe_pitch
        y = x * x
        st = x * (1.0 - y / 6.0 * (1.0 - y / 20.0 * (1.0 - y / 42.0 * (1.0 - y / 72.0 * (1.0 - y / 110.0)))))
        ct = 1.0 - y / 2.0 * (
            1.0 - y / 12.0 * (1.0 - y / 30.0 * (1.0 - y / 56.0 * (1.0 - y / 90.0 * (1.0 - y / 132.0))))
        )
        # From the frame of the pin to that of the lobe. Lever arms count from the bearing.
        rx = wheel.pin_circle_radius + pins[PIN_RADIAL_ERROR + j] - (cb * cx + sb * cy)
        ry = pins[PIN_TANGENTIAL_ERROR + j] - (cb * cy - sb * cx)
        px = ct * rx - st * ry
        py = st * rx + ct * ry
        rx = -(cb * cvx + sb * cvy)
        ry = -(cb * cvy - sb * cvx)
        vx = ct * rx - st * ry
        vy = st * rx + ct * ry
        rx = cb * run_x + sb * run_y
        ry = cb * run_y - sb * run_x
        ax = px - (ct * rx - st * ry) - tip
        ay = py - (st * rx + ct * ry)
        bx = ax + tip - wheel.pit_x
        by = ay - wheel.pit_y
        after_pit = by * wheel.pit_nx - bx * wheel.pit_ny
        chord_width = work[WEIGHT + j] * ((ay >= 0.0) & (part < 0.8))
        pit_width = chord_width * (after_pit < 0.0)
        work[WEIGHT + j] = 1.0 - pit_width
        # Chord or, before its beginning, the vertex at the tip.
        to_tip = np.sqrt(ax * ax + ay * ay)
        inverse = 1.0 / to_tip
        vertex_x = ax * inverse
        vertex_y = ay * inverse
        chord_gap = ax * ox + ay * oy - q
        at_vertex = ax * ux + ay * uy < 0.0
        nx = vertex_x if at_vertex else ox
        ny = vertex_y if at_vertex else oy
        gap = to_tip - q if at_vertex else chord_gap
        # Between profile and chord the effective radius follows the direction of the normal.
        turned = min(max(ny * inverse_oy, 0.0), 1.0)
        radius = wheel.tip_radius + turned * (q - wheel.tip_radius)
        arm = px * ny - py * nx
        gap_rate = nx * vx + ny * vy - rate * arm
        f1 = chord_width * contact_force(-gap, -gap_rate, radius, contact)
        fx = f1 * nx
        fy = f1 * ny
        # End point of the healthy flank at the pit.
        to_pit = np.sqrt(bx * bx + by * by)
        inverse = 1.0 / to_pit
        nx = bx * inverse
        ny = by * inverse
        arm = px * ny - py * nx
        gap_rate = nx * vx + ny * vy - rate * arm
        f2 = pit_width * contact_force(q - to_pit, -gap_rate, wheel.pit_radius, contact)
        fx += f2 * nx
        fy += f2 * ny
        work[FORCE + j] += f1 + f2
        # Back to the frame of the pin, then to the fixed one.
        rx = ct * fx + st * fy
        ry = ct * fy - st * fx
        total_x -= cb * rx - sb * ry
        total_y -= sb * rx + cb * ry
        moment -= px * fy - py * fx
    return total_x, total_y, moment


@njit(fastmath=FASTMATH)
def _removed_contacts(
    w, wheel, contact, pins, lobes, wear, work, runout_x, runout_y, theta, cos_theta, sin_theta, cx, cy,
    cvx, cvy, rate,
):  # fmt: skip
    """Contacts of the pins with the two edges left where lobes of wheel ``w`` have been removed.

    As :func:`_worn_contacts`; a removed lobe has no surface, the outline ends in the tips on either side.
    """
    n_lobes = wheel.n_lobes
    n_pins = n_lobes + 1
    pin_pitch = 2.0 * np.pi / n_pins
    lobe_pitch = 2.0 * np.pi / n_lobes
    cos_pitch = np.cos(lobe_pitch)
    sin_pitch = np.sin(lobe_pitch)
    total_x = 0.0
    total_y = 0.0
    moment = 0.0
    for lobe in range(n_lobes):
        if wear[w, lobe] != REMOVED:
            continue
        ck = lobes[LOBE_COS, lobe]
        sk = lobes[LOBE_SIN, lobe]
        cl = cos_theta * ck - sin_theta * sk
        sl = sin_theta * ck + cos_theta * sk
        first = int(np.ceil((theta + lobe * lobe_pitch) / pin_pitch - 0.25))
        for j in (first % n_pins, (first + 1) % n_pins):
            wx = wheel.pin_circle_radius + pins[PIN_RADIAL_ERROR + j]
            wy = pins[PIN_TANGENTIAL_ERROR + j]
            gx = pins[PIN_COS + j] * wx - pins[PIN_SIN + j] * wy - cx
            gy = pins[PIN_SIN + j] * wx + pins[PIN_COS + j] * wy - cy
            px = cl * gx + sl * gy
            py = cl * gy - sl * gx
            vx = -(cl * cvx + sl * cvy)
            vy = -(cl * cvy - sl * cvx)
            hx = ck * runout_x + sk * runout_y
            hy = ck * runout_y - sk * runout_x
            end_x = wheel.tip_x * cos_pitch
            end_y = wheel.tip_x * sin_pitch
            beyond_end = (py - hy - end_y) * cos_pitch - (px - hx - end_x) * sin_pitch
            if py - hy < 0.0 or beyond_end >= 0.0:
                continue
            work[WEIGHT + j] = 0.0
            for edge in range(2):
                neighbour = (lobe + 2 * edge - 1) % n_lobes
                if wear[w, neighbour] == REMOVED:
                    continue
                ax = px - hx - (end_x if edge == 1 else wheel.tip_x)
                ay = py - hy - (end_y if edge == 1 else 0.0)
                distance = np.sqrt(ax * ax + ay * ay)
                nx = ax / distance
                ny = ay / distance
                gap_rate = nx * vx + ny * vy - rate * (px * ny - py * nx)
                f = contact_force(wheel.pin_radius - distance, -gap_rate, wheel.tip_radius, contact)
                work[FORCE + j] += f
                total_x -= f * (cl * nx - sl * ny)
                total_y -= f * (sl * nx + cl * ny)
                moment -= f * (px * ny - py * nx)
    return total_x, total_y, moment


@njit(fastmath=FASTMATH)
def _joint_contacts(
    w, joint, contact, sleeves, cx, cy, cvx, cvy, cos_out, sin_out, cos_hole, sin_hole, rate_out, rate, force
):
    """Contacts of all internal sleeves with the holes of wheel ``w``.

    Returns force and moment on the wheel and the moment on the output shaft about the origin.
    """
    r = joint.pitch_radius
    shift_x = r * (cos_out - cos_hole)
    shift_y = r * (sin_out - sin_hole)
    total_x = 0.0
    total_y = 0.0
    moment = 0.0
    moment_out = 0.0
    for k in range(sleeves.shape[1]):
        ca = sleeves[0, k]
        sa = sleeves[1, k]
        dx = ca * shift_x - sa * shift_y - cx
        dy = sa * shift_x + ca * shift_y - cy
        distance = np.sqrt(dx * dx + dy * dy)
        inverse = 1.0 / distance
        nx = dx * inverse
        ny = dy * inverse
        hole_x = r * (ca * cos_hole - sa * sin_hole)
        hole_y = r * (sa * cos_hole + ca * sin_hole)
        sleeve_x = r * (ca * cos_out - sa * sin_out)
        sleeve_y = r * (sa * cos_out + ca * sin_out)
        arm = hole_x * ny - hole_y * nx
        arm_out = sleeve_x * ny - sleeve_y * nx
        penetration_rate = rate_out * arm_out - rate * arm - (cvx * nx + cvy * ny)
        f = contact_force(distance - joint.gap_at_centre, penetration_rate, contact.constant_radius, contact)
        force[w, k] = f
        total_x += f * nx
        total_y += f * ny
        moment += f * arm
        moment_out -= f * arm_out
    return total_x, total_y, moment, moment_out


@njit(fastmath=FASTMATH, forceinline=True)
def derivatives(
    phi, cos_phi, sin_phi, cos_slow, sin_slow, omega, alpha, load, state, wheel, joint, contact,
    joint_contact, body, pins, mounts, lobes, wear, sleeves, work, pin_force, sleeve_force, rates, result,
):  # fmt: skip
    """Right-hand side of the reduced model.

    ``slow`` stands for exp(-i phi / z_s). Writes the derivative of ``state`` into ``rates``, the forces of
    the pins into ``pin_force`` (2, n_pins), of the internal sleeves into ``sleeve_force`` (2, n_internal),
    and output and input torque into ``result``.
    """
    z = float(wheel.n_lobes)
    e = wheel.eccentricity
    mean_rate = -omega / z
    mean_acceleration = -alpha / z
    out_sin, out_cos = small_sincos(state[2])
    cos_out = cos_slow * out_cos - sin_slow * out_sin
    sin_out = sin_slow * out_cos + cos_slow * out_sin
    rate_out = mean_rate + state[6]
    moment_out = 0.0
    torque_in = 0.0
    for w in range(2):
        side = 1.0 - 2.0 * w
        cx = side * e * cos_phi
        cy = side * e * sin_phi
        cvx = -omega * cy
        cvy = omega * cx
        rate = mean_rate + state[4 + w]
        eps_sin, eps_cos = small_sincos(state[w])
        # Direction of the holes, eps - phi/z_s, and of the profile, theta = eps - phi/z_s + rest angle.
        cos_hole = cos_slow * eps_cos - sin_slow * eps_sin
        sin_hole = sin_slow * eps_cos + cos_slow * eps_sin
        cos_theta = cos_hole * mounts[w, REST_COS] - sin_hole * mounts[w, REST_SIN]
        sin_theta = sin_hole * mounts[w, REST_COS] + cos_hole * mounts[w, REST_SIN]
        # exp(-i z_s theta) = -exp(i phi_w) exp(-i z_s eps), phi_w the angle of the wheel's own cam.
        lobe_eps_sin, lobe_eps_cos = small_sincos(z * state[w])
        lobe_cos = -side * (cos_phi * lobe_eps_cos + sin_phi * lobe_eps_sin)
        lobe_sin = -side * (sin_phi * lobe_eps_cos - cos_phi * lobe_eps_sin)
        runout_x = mounts[w, RUNOUT_X]
        runout_y = mounts[w, RUNOUT_Y]
        run_x = cos_theta * runout_x - sin_theta * runout_y
        run_y = sin_theta * runout_x + cos_theta * runout_y
        offset_x = -(cx + e * lobe_cos) - run_x
        offset_y = -(cy + e * lobe_sin) - run_y
        for j in range(np.uintp(wheel.n_lobes + 1)):
            work[WEIGHT + j] = 1.0
            work[FORCE + j] = 0.0
        force_x = 0.0
        force_y = 0.0
        moment = 0.0
        fault_kind = int(mounts[w, FAULT_KIND])
        far = offset_x * offset_x + offset_y * offset_y >= wheel.near
        if fault_kind or far:
            theta = state[w] - phi / z + mounts[w, REST_ANGLE]
            if fault_kind & HAS_WORN:
                force_x, force_y, moment = _worn_contacts(
                    w, wheel, contact, pins, wear, work, run_x, run_y, theta, cx, cy, cvx, cvy, rate
                )
            if fault_kind & HAS_REMOVED:
                fx, fy, m = _removed_contacts(
                    w, wheel, contact, pins, lobes, wear, work, runout_x, runout_y, theta, cos_theta,
                    sin_theta, cx, cy, cvx, cvy, rate,
                )  # fmt: skip
                force_x += fx
                force_y += fy
                moment += m
            if far:
                fx, fy, m = _far_profile_contacts(
                    wheel, contact, pins, work, cx, cy, cvx, cvy, offset_x, offset_y, lobe_cos, lobe_sin, rate
                )
                force_x += fx
                force_y += fy
                moment += m
        fx, fy, m = _profile_contacts(
            wheel, contact, pins, work, cx, cy, cvx, cvy, offset_x, offset_y, lobe_cos, lobe_sin, rate
        )
        for j in range(np.uintp(wheel.n_lobes + 1)):
            pin_force[w, j] = work[FORCE + j]
        jx, jy, joint_moment, on_output = _joint_contacts(
            w, joint, joint_contact, sleeves, cx, cy, cvx, cvy, cos_out, sin_out, cos_hole, sin_hole,
            rate_out, rate, sleeve_force,
        )  # fmt: skip
        force_x += fx + jx
        force_y += fy + jy
        moment += m + joint_moment
        moment_out += on_output
        rates[w] = state[4 + w]
        rates[4 + w] = moment / body.wheel_inertia - mean_acceleration
        # Cam's force on the wheel, and its moment about the input shaft.
        reaction_x = body.wheel_mass * (-alpha * cy - omega * omega * cx) - force_x
        reaction_y = body.wheel_mass * (alpha * cx - omega * omega * cy) - force_y
        torque_in += cx * reaction_y - cy * reaction_x
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


@njit(fastmath=FASTMATH, inline="always")
def _turn(cosine, sine, angle):
    """Rotate (cosine, sine) by a small angle and pull the result back onto the unit circle."""
    s, c = small_sincos(angle)
    x = cosine * c - sine * s
    y = sine * c + cosine * s
    scale = 1.5 - 0.5 * (x * x + y * y)
    return x * scale, y * scale


# Steps between two exact evaluations of the driver's sines; turning by polynomials in between is cheaper.
RESYNC = 128


@njit(fastmath=FASTMATH)
def integrate(
    n_steps, dt, phi, omega, alpha, load, state, wheel, joint, contact, joint_contact, body, pins, mounts,
    lobes, wear, sleeves, limit, result, angles, pin_force, sleeve_force, pin_forces, sleeve_forces,
):  # fmt: skip
    """Midpoint rule (second-order Runge-Kutta) over ``n_steps`` steps.

    ``phi``, ``omega``, ``alpha``, ``load`` hold the driver and load at every half step: (2 n_steps + 1,).
    ``result`` is (n_steps, 2), ``angles`` (n_steps or 0, 4), ``pin_forces`` (n_steps or 0, 2, n_pins),
    ``sleeve_forces`` (n_steps or 0, 2, n_internal). Returns the number of finished steps: fewer than
    ``n_steps`` where a torque exceeded ``limit`` or was not a number. ``pin_force`` (2, n_pins) and
    ``sleeve_force`` (2, n_internal) hold the last forces.
    """
    z = float(wheel.n_lobes)
    work = np.zeros(WORK_SIZE)
    rates = np.zeros(N_STATE)
    middle = np.zeros(N_STATE)
    now = np.zeros(N_RESULT)
    scratch = np.zeros(N_RESULT)
    cos_phi = 1.0
    sin_phi = 0.0
    cos_slow = 1.0
    sin_slow = 0.0
    for step in range(n_steps):
        i = 2 * step
        if step % RESYNC == 0:
            cos_phi = np.cos(phi[i])
            sin_phi = np.sin(phi[i])
            cos_slow = np.cos(phi[i] / z)
            sin_slow = -np.sin(phi[i] / z)
        else:
            turn = phi[i] - phi[i - 1]
            cos_phi, sin_phi = _turn(cos_phi, sin_phi, turn)
            cos_slow, sin_slow = _turn(cos_slow, sin_slow, -turn / z)
        derivatives(
            phi[i], cos_phi, sin_phi, cos_slow, sin_slow, omega[i], alpha[i], load[i], state, wheel, joint,
            contact, joint_contact, body, pins, mounts, lobes, wear, sleeves, work, pin_force, sleeve_force,
            rates, now,
        )  # fmt: skip
        result[step, 0] = now[0]
        result[step, 1] = now[1]
        if step < angles.shape[0]:
            for k in range(4):
                angles[step, k] = state[k]
        if step < pin_forces.shape[0]:
            pin_forces[step] = pin_force
        if step < sleeve_forces.shape[0]:
            sleeve_forces[step] = sleeve_force
        if not (abs(now[0]) < limit and abs(now[1]) < limit):
            return step
        for k in range(N_STATE):
            middle[k] = state[k] + 0.5 * dt * rates[k]
        turn = phi[i + 1] - phi[i]
        cos_phi, sin_phi = _turn(cos_phi, sin_phi, turn)
        cos_slow, sin_slow = _turn(cos_slow, sin_slow, -turn / z)
        derivatives(
            phi[i + 1], cos_phi, sin_phi, cos_slow, sin_slow, omega[i + 1], alpha[i + 1], load[i + 1], middle,
            wheel, joint, contact, joint_contact, body, pins, mounts, lobes, wear, sleeves, work, pin_force,
            sleeve_force, rates, scratch,
        )  # fmt: skip
        for k in range(N_STATE):
            state[k] += dt * rates[k]
    return n_steps
