"""Contacts of the pins with the outlines of the wheels: numba, floats and arrays only.

Each contact within reach is described once by a local frame on the wheel. The description holds until the
wheel has moved by a small fraction of the profile's curvature (:func:`moved_on`); until then the kernel needs
no trigonometry, no iteration and no contacts that cannot close. In the frame, n points out of the wheel and t
is n turned by a quarter turn, both in the fixed axes at the time of the description; (v, u) are a pin's
coordinates along (n, t).

- *Flanks*: the profile's gap to third order in u. Two weights, one for each side of a line across the
  contact, switch it where the outline passes into a worn or removed lobe.
- *Edges*: a straight line that ends in a vertex (the chord of a worn lobe and its tip), or a vertex alone
  (the end of a flank at a pit or at a removed lobe).
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from cyclofeat.simulators._jit import njit

# Entry of the lobe table for a removed lobe; 0 is healthy, up to 1 the share of the width that is worn.
REMOVED = 2.0

# Reassociation vectorises the sums over contacts. Infinities and NaN stay exact: they show divergence.
FASTMATH = {"reassoc", "contract", "arcp", "nsz"}

# Named tuples of numbers only: an array inside one would be reference-counted at every call.
WheelConstants = namedtuple(
    "WheelConstants",
    [
        "eccentricity",  # m
        "shortening",
        "n_lobes",
        "pin_radius",  # m
        "pin_circle_radius",  # m
        "clearance",  # of the pins, m: the outline lies so much deeper
        "tip_x",  # tip of lobe 0, on the x axis, m
        "pit_x",  # pit of lobe 0, m
        "pit_y",
        "pit_nx",  # outward unit normal of the profile at the pit
        "pit_ny",
        "tip_radius",  # effective contact radius at the tip, m
        "pit_radius",  # and at the pit, m
        "near",  # displacement up to which Newton's steps find the foot of every pin, m
        "has_pitch_errors",
        "profile_points",  # corners of a polyline in place of the smooth profile; 0 for smooth
        "wear_first",  # radial wear: from how far behind the tip on, in pitches
        "wear_width",  # and over how much
    ],
)

# Tables with one column per pin or contact are flat arrays of rows of fixed length with unsigned indices: the
# compiler then knows that rows do not overlap and vectorises. A power of two would collide in the cache.
COLUMNS = 136
EDGE_COLUMNS = 272
# Contacts are padded to whole blocks of one vector.
BLOCK = 8

# Rows of the table of pins.
PIN_COS, PIN_SIN, PIN_RADIAL_ERROR, PIN_TANGENTIAL_ERROR, PIN_ANGLE = (
    np.uintp(row * COLUMNS) for row in range(5)
)
# Rows of the table of lobes; from PITCH_ERROR on, one for each wheel.
LOBE_COS, LOBE_SIN, PITCH_ERROR = (np.uintp(row * COLUMNS) for row in range(3))
# Mounts, descriptions and numbers of contacts have one row for each wheel.
WHEEL_TABLE_SIZE = 2 * COLUMNS
# Rows of the table of wear, each for both wheels: share of the chord or REMOVED, and radial wear in m.
RADIAL = np.uintp(WHEEL_TABLE_SIZE)
# Columns of the mounts, the cam in the input shaft's frame.
REST_ANGLE, REST_COS, REST_SIN, RUNOUT_X, RUNOUT_Y, CAM_X, CAM_Y, HAS_FAULTS = (np.uintp(k) for k in range(8))

# Rows of working memory: the foot's parameter, the pin's displacement, the lobe's pitch error and its slope.
STEP, DISPLACED_X, DISPLACED_Y, TURNED, TURNED_SLOPE = (np.uintp(row * COLUMNS) for row in range(5))
FEET_SIZE = 5 * COLUMNS
# Rows of the flanks: the pin's coordinates along n and t at angle 0, normal, zeros of v and u, the gap
# and its derivatives along u, effective radius and its derivatives, the line across (value, slopes
# along v and u), the weights on its negative and positive sides, the pin. The kernel writes force and tilt.
(
    F_ALONG_N, F_ALONG_T, F_NX, F_NY, F_V, F_U, F_GAP, F_SLOPE, F_BEND, F_CHANGE, F_RADIUS, F_RADIUS_SLOPE,
    F_RADIUS_BEND, F_LINE, F_LINE_V, F_LINE_U, F_BEFORE, F_BEYOND, F_PIN, F_FORCE, F_TILT,
) = (np.uintp(row * COLUMNS) for row in range(21))  # fmt: skip
FLANK_SIZE = 21 * COLUMNS
# Rows of the edges: as above, with the largest u beside the line (0 for a line, infinity for a vertex), the
# radius by direction, and the weight where the line across is positive. The kernel writes force, direction.
(
    E_ALONG_N, E_ALONG_T, E_NX, E_NY, E_V, E_U, E_BESIDE, E_LINE, E_LINE_V, E_LINE_U, E_RADIUS,
    E_RADIUS_SPAN, E_TURN, E_WEIGHT, E_PIN, E_FORCE, E_ALONG, E_TILT,
) = (np.uintp(row * EDGE_COLUMNS) for row in range(18))  # fmt: skip
EDGE_SIZE = 18 * EDGE_COLUMNS
# Per wheel, at the description: input angle, deviation from rest, cell; numbers of contacts, padded and used.
SEEN_PHI, SEEN_EPS, SEEN_CELL = (np.uintp(k) for k in range(3))
N_FLANKS, N_EDGES, USED_FLANKS, USED_EDGES = (np.uintp(k) for k in range(4))

# A description holds inside one of 672 cells of the input turn (a multiple of many numbers of pins: records
# stay periodic) and for this deviation of the wheel in rad. Pins slide by at most 0.03 mm in that; the
# expansion errs by less than 1e-4 of a force. No step falls on a border, where rounding would decide.
CELLS_PER_RADIAN, FIRST_BORDER = 672 / (2.0 * np.pi), 0.3819
HOLDS_EPS = 1e-4
# Contacts open by more than these shares of the pin circle (of the displacement, where pins are displaced)
# cannot close before the next description.
FLANK_REACH, EDGE_REACH, DISPLACED_REACH = 5e-4, 1.5e-3, 0.04

# A pin belongs to a lobe from this share of the pitch before its tip (its foot may lie ahead of the rest
# position) and may touch the chord up to CHORD_ENDS.
LEAD, CHORD_ENDS = 0.06, 0.74

NEWTON_STEPS = 3
# Largest step of the foot in rad of the profile's parameter: pins beyond it are far from touching, and the
# polynomials below are exact to rounding up to it.
LARGEST_STEP = 0.03
# Search for the foot of a far displaced pin: half width (half pitches) and points of the grid, Newton steps.
SEARCH_WIDTH, SEARCH_POINTS, SEARCH_STEPS = 0.75, 33, 40


@njit(fastmath=FASTMATH, inline="always")
def small_sincos(x):
    """Sine and cosine; short polynomials (rounding only) for |x| < 0.02, the library beyond."""
    if abs(x) > 0.02:
        return np.sin(x), np.cos(x)
    y = x * x
    return x * (1.0 + y * (y / 120.0 - 1.0 / 6.0)), 1.0 + y * (y * (1.0 / 24.0 - y / 720.0) - 0.5)


@njit(fastmath=FASTMATH, inline="always")
def _turn_cell(phi):
    return np.floor(phi * CELLS_PER_RADIAN + FIRST_BORDER)


@njit(fastmath=FASTMATH, inline="always")
def moved_on(seen, w, wheel, phi, eps):
    """Return True if the description of wheel ``w`` no longer holds; for NaN it never does."""
    own = np.uintp(w * COLUMNS)
    same_cell = _turn_cell(phi) == seen[own + SEEN_CELL]
    at_rest = abs(eps - seen[own + SEEN_EPS]) < HOLDS_EPS
    return not (same_cell and at_rest) or wheel.profile_points > 0


@njit(fastmath=FASTMATH)
def _newton_feet(wheel, pins, feet, lobe_cos, lobe_sin):
    """Parameter of each displaced pin's foot, counted from the rest position: a branch-free loop."""
    eccentricity = wheel.eccentricity
    inverse_m = 1.0 / wheel.shortening
    n_lobes = float(wheel.n_lobes)
    n_pins = n_lobes + 1.0
    big_r = wheel.pin_circle_radius
    inverse_ez = 1.0 / (eccentricity * n_pins)
    largest = LARGEST_STEP * 16.0 / n_pins
    for j in range(np.uintp(wheel.n_lobes + 1)):
        cb, sb = pins[PIN_COS + j], pins[PIN_SIN + j]
        dx, dy = feet[DISPLACED_X + j], feet[DISPLACED_Y + j]
        # exp(i z_s t) at the rest position's foot is exp(-i beta) exp(-i z_s theta).
        qx, qy = cb * lobe_cos + sb * lobe_sin, cb * lobe_sin - sb * lobe_cos
        step = 0.0
        for _ in range(NEWTON_STEPS):
            y = step * step
            s1 = step * (1.0 - y / 6.0 * (1.0 - y / 20.0 * (1.0 - y / 42.0)))
            v1 = y / 2.0 * (1.0 - y / 12.0 * (1.0 - y / 30.0 * (1.0 - y / 56.0)))  # 1 - cos
            x = n_pins * step
            y = x * x
            s2 = x * (1.0 - y / 6.0 * (1.0 - y / 20.0 * (1.0 - y / 42.0 * (1.0 - y / 72.0))))
            v2 = y / 2.0 * (1.0 - y / 12.0 * (1.0 - y / 30.0 * (1.0 - y / 56.0 * (1.0 - y / 90.0))))
            rx = dx + big_r * v1 + eccentricity * (qx * v2 + qy * s2)
            ry = dy - big_r * s1 + eccentricity * (qy * v2 - qx * s2)
            wx, wy = (1.0 - v2) * qx - s2 * qy, (1.0 - v2) * qy + s2 * qx
            hx, hy = (1.0 - v1) * inverse_m + wx, s1 * inverse_m + wy
            ahead = (ry * hx - rx * hy) * inverse_ez
            flat = hx * hx + hy * hy
            slope = flat + (rx * (hx + n_lobes * wx) + ry * (hy + n_lobes * wy)) * inverse_ez
            step += ahead / max(slope, 0.3 * flat)
            step = min(max(step, -largest), largest)
        feet[STEP + j] = step


@njit(fastmath=FASTMATH, inline="always")
def _at_foot(wheel, dx, dy, qx, qy, step):
    """Vector from the profile at ``step`` to a displaced pin, the tangent's factor, and sine and cosine."""
    inverse_m = 1.0 / wheel.shortening
    s1, c1 = small_sincos(step)
    s2, c2 = small_sincos(float(wheel.n_lobes + 1) * step)
    wx, wy = c2 * qx - s2 * qy, c2 * qy + s2 * qx
    rx = dx + wheel.pin_circle_radius * (1.0 - c1) + wheel.eccentricity * (qx - wx)
    ry = dy - wheel.pin_circle_radius * s1 + wheel.eccentricity * (qy - wy)
    # exp(i step) g(t), g = 1/m + exp(i z_s t) being the factor of the tangent i e z_k exp(it) g.
    return rx, ry, c1 * inverse_m + wx, s1 * inverse_m + wy, s1, c1


@njit(fastmath=FASTMATH)
def _searched_foot(wheel, dx, dy, qx, qy):
    """As :func:`_newton_feet` for one far displaced pin; removed lobes of both wheels let the output slip."""
    n_lobes = float(wheel.n_lobes)
    inverse_m = 1.0 / wheel.shortening
    inverse_ez = 1.0 / (wheel.eccentricity * (n_lobes + 1.0))
    width = SEARCH_WIDTH * np.pi / n_lobes
    spacing = 2.0 * width / (SEARCH_POINTS - 1)
    step = 0.0
    nearest = np.inf
    for k in range(SEARCH_POINTS):
        trial = k * spacing - width
        rx, ry, _, _, _, _ = _at_foot(wheel, dx, dy, qx, qy, trial)
        distance = rx * rx + ry * ry
        if distance < nearest:
            nearest = distance
            step = trial
    # Newton steps, kept inside a bracket that shrinks.
    low, high = step - spacing, step + spacing
    for _ in range(SEARCH_STEPS):
        rx, ry, hx, hy, s1, c1 = _at_foot(wheel, dx, dy, qx, qy, step)
        wx, wy = hx - c1 * inverse_m, hy - s1 * inverse_m
        ahead = (ry * hx - rx * hy) * inverse_ez
        slope = hx * hx + hy * hy + (rx * (hx + n_lobes * wx) + ry * (hy + n_lobes * wy)) * inverse_ez
        if ahead > 0.0:
            low = step
        else:
            high = step
        following = step + ahead / slope if slope > 0.0 else high + 1.0
        if not low < following < high:
            following = 0.5 * (low + high)
        change = abs(following - step)
        step = following
        if change < 1e-13:
            break
    return step


@njit(fastmath=FASTMATH)
def _worn_foot(wheel, depth, part, dx, dy, qx, qy, step):
    """Nearest place to a pin on the path of pins over radial wear, which lies beside the healthy foot.

    Returns the way there from the foot, the wear, the slope of the path against the profile's, and by how
    much the path is more curved (to first order).
    """
    z = float(wheel.n_lobes)
    inverse_m = 1.0 / wheel.shortening
    inverse_ez = 1.0 / (wheel.eccentricity * (z + 1.0))
    pitch = 2.0 * np.pi / z
    rate = 2.0 * np.pi / (wheel.wear_width * pitch)
    begin = (part - wheel.wear_first) * pitch * rate
    way = 0.0
    sink = 0.0
    slope = 0.0
    bend = 0.0
    for _ in range(NEWTON_STEPS + 1):
        angle = min(max(begin + way * rate, 0.0), 2.0 * np.pi)
        rx, ry, hx, hy, s1, c1 = _at_foot(wheel, dx, dy, qx, qy, step + way)
        ig = 1.0 / np.sqrt(hx * hx + hy * hy)
        kappa = inverse_ez * (1.0 + 0.5 * z + 0.5 * z * (1.0 - inverse_m * inverse_m) * ig * ig) * ig
        above = (rx * hx + ry * hy) * ig
        beside = (ry * hx - rx * hy) * ig
        by_length = inverse_ez * ig
        growth = -z * inverse_m * (c1 * hy - s1 * hx) * ig * ig
        sine = np.sin(angle)
        cosine = np.cos(angle)
        raised = 0.5 * (1.0 - cosine)
        sink = depth * raised * raised
        change = depth * raised * sine * rate
        bend = depth * (0.5 * sine * sine + raised * cosine) * rate * rate
        bend = (bend - change * growth) * by_length * by_length
        slope = change * by_length / (1.0 - kappa * (sink + wheel.clearance))
        height = above + wheel.clearance + sink
        way += (beside - height * slope) / (1.0 + kappa * above + height * bend + slope * slope) * by_length
    return way, sink, slope, bend


@njit(fastmath=FASTMATH)
def _polyline_foot(wheel, t, x, y):
    """Distance and direction of pin (x, y) from the polyline, in the wheel's frame; ``t``: smooth foot."""
    n_pins = float(wheel.n_lobes + 1)
    depth = wheel.pin_radius + wheel.clearance
    spacing = 2.0 * np.pi / wheel.profile_points
    first = np.floor(t / spacing) - 2.0
    nearest = np.inf
    best_x, best_y = 0.0, 0.0
    last_x, last_y = 0.0, 0.0
    for k in range(6):
        s = (first + k) * spacing
        gx = np.cos(s) / wheel.shortening + np.cos(n_pins * s)
        gy = np.sin(s) / wheel.shortening + np.sin(n_pins * s)
        shrink = depth / np.sqrt(gx * gx + gy * gy)
        px = wheel.pin_circle_radius * np.cos(s) + wheel.eccentricity * np.cos(n_pins * s) - shrink * gx
        py = wheel.pin_circle_radius * np.sin(s) + wheel.eccentricity * np.sin(n_pins * s) - shrink * gy
        if k > 0:
            ax, ay = px - last_x, py - last_y
            share = ((x - last_x) * ax + (y - last_y) * ay) / (ax * ax + ay * ay)
            share = min(max(share, 0.0), 1.0)
            rx, ry = x - last_x - share * ax, y - last_y - share * ay
            distance = np.sqrt(rx * rx + ry * ry)
            if distance < nearest:
                nearest = distance
                best_x, best_y = rx / distance, ry / distance
        last_x, last_y = px, py
    return nearest, best_x, best_y


@njit(fastmath=FASTMATH)
def _displaced_pins(w, wheel, pins, lobes, feet, theta, offset_x, offset_y, cx, cy):
    """Vector from each pin's foot at rest to its centre, in its frame; a pitch error turns the pin back."""
    n_lobes = wheel.n_lobes
    pitch = 2.0 * np.pi / n_lobes
    for j in range(np.uintp(n_lobes + 1)):
        cb, sb = pins[PIN_COS + j], pins[PIN_SIN + j]
        feet[DISPLACED_X + j] = cb * offset_x + sb * offset_y + pins[PIN_RADIAL_ERROR + j]
        feet[DISPLACED_Y + j] = cb * offset_y - sb * offset_x + pins[PIN_TANGENTIAL_ERROR + j]
        feet[TURNED + j] = 0.0
        feet[TURNED_SLOPE + j] = 0.0
    if not wheel.has_pitch_errors:
        return
    for j in range(np.uintp(n_lobes + 1)):
        place = (pins[PIN_ANGLE + j] - theta) / pitch
        if abs(place) < 1e9:
            whole = np.floor(place)
            error, slope = _pitch_error(lobes, w, int(whole) % n_lobes, n_lobes, place - whole)
            cb, sb = pins[PIN_COS + j], pins[PIN_SIN + j]
            feet[DISPLACED_X + j] += error * (cb * -cy - sb * -cx)
            feet[DISPLACED_Y + j] -= error * (wheel.pin_circle_radius - cb * cx - sb * cy)
            feet[TURNED + j] = error
            feet[TURNED_SLOPE + j] = slope / pitch


@njit(fastmath=FASTMATH)
def _pitch_error(lobes, w, lobe, n_lobes, part):
    """Angle in rad by which the profile is displaced at share ``part`` of a lobe, and its slope by share.

    The half from tip to pit is displaced as a whole; the other half passes smoothly to the next lobe.
    """
    own = np.uintp(w * COLUMNS)
    here = lobes[own + PITCH_ERROR + np.uintp(lobe)]
    if part < 0.5:
        return here, 0.0
    change = lobes[own + PITCH_ERROR + np.uintp((lobe + 1) % n_lobes)] - here
    x = 2.0 * part - 1.0
    return here + change * x * x * (3.0 - 2.0 * x), change * 12.0 * x * (1.0 - x)


@njit(fastmath=FASTMATH)
def _lobe_direction(lobes, w, lobe, cos_theta, sin_theta):
    """Direction of a lobe's tip in the fixed frame, turned by its pitch error."""
    own = np.uintp(w * COLUMNS)
    error = lobes[own + PITCH_ERROR + np.uintp(lobe)]
    sine, cosine = small_sincos(error)
    cl = cosine * lobes[LOBE_COS + np.uintp(lobe)] - sine * lobes[LOBE_SIN + np.uintp(lobe)]
    sl = cosine * lobes[LOBE_SIN + np.uintp(lobe)] + sine * lobes[LOBE_COS + np.uintp(lobe)]
    return cos_theta * cl - sin_theta * sl, sin_theta * cl + cos_theta * sl


@njit(fastmath=FASTMATH)
def _add_edge(
    w, edges, n, wheel, cs, sn, nx, ny, point_x, point_y, line_x, line_y, line_at, beside, radius, span, turn,
    weight, j, pin_x, pin_y, lever_x, lever_y, reach,
):  # fmt: skip
    """Append one edge if it is within reach; return the number of edges.

    Normal, vertex (from the wheel's bearing) and line across are in the frame of the lobe, whose direction is
    (cs, sn); ``pin`` is the pin's centre in the fixed frame, ``lever`` the vector from the bearing to it.
    """
    lx, ly = cs * lever_x + sn * lever_y, cs * lever_y - sn * lever_x
    v = (lx - point_x) * nx + (ly - point_y) * ny
    u = min((ly - point_y) * nx - (lx - point_x) * ny, beside)
    if not np.sqrt(v * v + u * u) < wheel.pin_radius + reach or v < -reach:
        return n
    fx, fy = cs * nx - sn * ny, sn * nx + cs * ny
    k = np.uintp(w * EDGE_SIZE + n)
    edges[E_NX + k] = fx
    edges[E_NY + k] = fy
    edges[E_ALONG_N + k] = pin_x * fx + pin_y * fy
    edges[E_ALONG_T + k] = pin_y * fx - pin_x * fy
    edges[E_V + k] = point_x * nx + point_y * ny
    edges[E_U + k] = point_y * nx - point_x * ny
    edges[E_BESIDE + k] = beside
    edges[E_LINE + k] = point_x * line_x + point_y * line_y - line_at
    edges[E_LINE_V + k] = nx * line_x + ny * line_y
    edges[E_LINE_U + k] = nx * line_y - ny * line_x
    edges[E_RADIUS + k] = radius
    edges[E_RADIUS_SPAN + k] = span
    edges[E_TURN + k] = turn
    edges[E_WEIGHT + k] = weight
    edges[E_PIN + k] = j
    return n + 1


@njit(fastmath=FASTMATH)
def _describe_edges(
    w, wheel, pins, lobes, wear, edges, theta, cos_theta, sin_theta, cx, cy, run_x, run_y, displaced
):
    """Fill the table of edges within reach on worn and removed lobes; return their number.

    A pin rests on the tip's vertex before it lies on the chord. At the re-entrant pit it touches chord and
    the end of the flank. A removed lobe has no surface: the outline ends in the tips on both sides.
    """
    own = np.uintp(w * COLUMNS)
    n_lobes = wheel.n_lobes
    pitch = 2.0 * np.pi / n_lobes
    reach = EDGE_REACH * wheel.pin_circle_radius + DISPLACED_REACH * displaced
    q = wheel.pin_radius
    tip = wheel.tip_x
    length = np.sqrt((wheel.pit_x - tip) ** 2 + wheel.pit_y**2)
    # Outward normal of the chord of lobe 0.
    ox, oy = wheel.pit_y / length, (tip - wheel.pit_x) / length
    n = 0
    for j in range(n_lobes + 1):
        place = (pins[PIN_ANGLE + np.uintp(j)] - theta) / pitch
        if not abs(place) < 1e9:
            return n  # not a number, or lost
        whole = np.floor(place + LEAD)
        part = place - whole
        worn_lobe = int(whole) % n_lobes
        share = wear[own + np.uintp(worn_lobe)]
        tip_lobe = int(np.floor(place + 0.5)) % n_lobes
        removed_ahead = wear[own + np.uintp(tip_lobe)] == REMOVED
        removed_behind = wear[own + np.uintp((tip_lobe - 1) % n_lobes)] == REMOVED
        at_edge = removed_ahead != removed_behind
        on_chord = 0.0 < share <= 1.0 and part <= CHORD_ENDS
        if not (at_edge or on_chord):
            continue
        cb, sb = pins[PIN_COS + np.uintp(j)], pins[PIN_SIN + np.uintp(j)]
        radial = wheel.pin_circle_radius + pins[PIN_RADIAL_ERROR + np.uintp(j)]
        tangential = pins[PIN_TANGENTIAL_ERROR + np.uintp(j)]
        pin_x, pin_y = cb * radial - sb * tangential, sb * radial + cb * tangential
        lever_x, lever_y = pin_x - cx, pin_y - cy
        if at_edge:
            cs, sn = _lobe_direction(lobes, w, tip_lobe, cos_theta, sin_theta)
            hx, hy = cs * run_x + sn * run_y, cs * run_y - sn * run_x
            side = 1.0 if removed_ahead else -1.0
            n = _add_edge(
                w, edges, n, wheel, cs, sn, 1.0, 0.0, hx + tip, hy, 0.0, side, side * hy, np.inf,
                wheel.tip_radius, 0.0, 0.0, 1.0, j, pin_x, pin_y, lever_x, lever_y, reach,
            )  # fmt: skip
        if on_chord:
            cs, sn = _lobe_direction(lobes, w, worn_lobe, cos_theta, sin_theta)
            hx, hy = cs * run_x + sn * run_y, cs * run_y - sn * run_x
            n = _add_edge(
                w, edges, n, wheel, cs, sn, ox, oy, hx + tip, hy, 0.0, 1.0, hy, 0.0,
                wheel.tip_radius, q - wheel.tip_radius, ox / oy, share, j, pin_x, pin_y, lever_x, lever_y,
                reach,
            )  # fmt: skip
            # before the pit's own normal
            line_x, line_y = wheel.pit_ny, -wheel.pit_nx
            pit_x, pit_y = hx + wheel.pit_x, hy + wheel.pit_y
            n = _add_edge(
                w, edges, n, wheel, cs, sn, wheel.pit_nx, wheel.pit_ny, pit_x, pit_y,
                line_x, line_y, pit_x * line_x + pit_y * line_y, np.inf,
                wheel.pit_radius, 0.0, 0.0, share, j, pin_x, pin_y, lever_x, lever_y, reach,
            )  # fmt: skip
    return n


@njit(fastmath=FASTMATH)
def describe(
    w, wheel, pins, mounts, lobes, wear, feet, flanks, edges, seen, counts, phi, eps, cos_theta, sin_theta,
    cx, cy, lobe_cos, lobe_sin,
):  # fmt: skip
    """Describe all contacts of wheel ``w`` within reach: writes ``flanks``, ``edges``, ``seen``, ``counts``.

    ``c`` is the cam's centre, ``lobe`` = exp(-i z_s theta), ``feet`` (FEET_SIZE,) working memory.
    """
    own = np.uintp(w * COLUMNS)
    eccentricity = wheel.eccentricity
    inverse_m = 1.0 / wheel.shortening
    n_lobes = wheel.n_lobes
    z = float(n_lobes)
    n_pins = z + 1.0
    q = wheel.pin_radius
    big_r = wheel.pin_circle_radius
    inverse_ez = 1.0 / (eccentricity * n_pins)
    pitch = 2.0 * np.pi / z
    theta = eps - phi / z + mounts[own + REST_ANGLE]
    run_x = cos_theta * mounts[own + RUNOUT_X] - sin_theta * mounts[own + RUNOUT_Y]
    run_y = sin_theta * mounts[own + RUNOUT_X] + cos_theta * mounts[own + RUNOUT_Y]
    # From the foot at rest to the pin's centre: the same for all pins.
    offset_x, offset_y = -(cx + eccentricity * lobe_cos) - run_x, -(cy + eccentricity * lobe_sin) - run_y
    displaced = np.sqrt(offset_x * offset_x + offset_y * offset_y)
    far = displaced >= wheel.near
    has_faults = mounts[own + HAS_FAULTS] != 0.0
    reach = FLANK_REACH * big_r + DISPLACED_REACH * displaced
    _displaced_pins(w, wheel, pins, lobes, feet, theta, offset_x, offset_y, cx, cy)
    _newton_feet(wheel, pins, feet, lobe_cos, lobe_sin)
    curve_1 = inverse_ez * (1.0 + 0.5 * z)
    curve_3 = inverse_ez * 0.5 * z * (1.0 - inverse_m * inverse_m)
    steepness = z * inverse_m * inverse_ez
    first = np.uintp(w * FLANK_SIZE)
    n = first
    for j in range(np.uintp(n_lobes + 1)):
        cb, sb = pins[PIN_COS + j], pins[PIN_SIN + j]
        # Every pin is treated in its own frame (radial, tangential).
        dx, dy = feet[DISPLACED_X + j], feet[DISPLACED_Y + j]
        qx, qy = cb * lobe_cos + sb * lobe_sin, cb * lobe_sin - sb * lobe_cos
        step = _searched_foot(wheel, dx, dy, qx, qy) if far else feet[STEP + j]
        place = (pins[PIN_ANGLE + j] - theta + step) / pitch
        lobe = 0
        part = 0.0
        if abs(place) < 1e9:
            whole = np.floor(place)
            part = place - whole
            lobe = int(whole) % n_lobes
        worn = wear[RADIAL + own + np.uintp(lobe)]
        if worn > 0.0:
            way, sink, worn_slope, worn_bend = _worn_foot(wheel, worn, part, dx, dy, qx, qy, step)
            step += way
            place += way / pitch
            part += way / pitch
        rx, ry, hx, hy, s1, c1 = _at_foot(wheel, dx, dy, qx, qy, step)
        ig = 1.0 / np.sqrt(hx * hx + hy * hy)
        nx, ny = hx * ig, hy * ig
        distance = rx * nx + ry * ny
        gap = distance + wheel.clearance
        # With cos(z_s t)/m = (|g|^2 - 1 - 1/m^2)/2 the curvature is curve_1/|g| + curve_3/|g|^3; its change
        # along the trochoid follows from d|g|/dt = -z_s sin(z_s t)/(m |g|).
        cubic = curve_3 * ig * ig
        kappa = (curve_1 + cubic) * ig
        sine_lobe = c1 * hy - s1 * hx
        cosine_lobe = c1 * hx + s1 * hy - inverse_m
        change = (curve_1 + 3.0 * cubic) * (ig * ig) * (ig * ig) * steepness * sine_lobe
        second = (4.0 * curve_1 + 18.0 * cubic) * (steepness * sine_lobe) ** 2 * ig**7
        second += (
            (curve_1 + 3.0 * cubic) * (ig * ig) * (ig * ig) * steepness * z * cosine_lobe * inverse_ez * ig
        )
        # A coarse polyline stands proud of concave flanks by more than the reach.
        if not gap < reach and wheel.profile_points == 0:
            continue
        before, beyond = 1.0, 1.0
        line_value = 1.0
        line_x, line_y = 0.0, 0.0
        lever_x = big_r + pins[PIN_RADIAL_ERROR + j] - (cb * cx + sb * cy)
        lever_y = pins[PIN_TANGENTIAL_ERROR + j] - (cb * cy - sb * cx)
        if has_faults:
            # The next place where lobes or their halves meet: tip, pit, or the next tip.
            share = wear[own + np.uintp(lobe)]
            if share == REMOVED and 0.25 <= part < 0.75:
                continue
            ahead = lobe
            if part >= 0.75:
                ahead = (lobe + 1) % n_lobes
            if 0.25 <= part < 0.75:
                before = 1.0 - share
                # along the profile, across the pit's normal
                direction_x, direction_y = -wheel.pit_ny, wheel.pit_nx
                point_x, point_y = wheel.pit_x, wheel.pit_y
            else:
                behind = wear[own + np.uintp((ahead - 1) % n_lobes)]
                before = 0.0 if behind == REMOVED else 1.0
                beyond = 0.0 if wear[own + np.uintp(ahead)] == REMOVED else 1.0 - wear[own + np.uintp(ahead)]
                direction_x, direction_y = 0.0, 1.0
                point_x, point_y = 0.0, 0.0
            if before == 0.0 and beyond == 0.0:
                continue
            cs, sn = _lobe_direction(lobes, w, ahead, cos_theta, sin_theta)
            # The lobe's direction, then the line's, in the frame of the pin.
            cl, sl = cb * cs + sb * sn, cb * sn - sb * cs
            line_x, line_y = cl * direction_x - sl * direction_y, sl * direction_x + cl * direction_y
            middle_x, middle_y = cb * run_x + sb * run_y, cb * run_y - sb * run_x
            line_value = (
                (lever_x - middle_x) * line_x
                + (lever_y - middle_y) * line_y
                - (point_x * direction_x + point_y * direction_y)
            )
        # A pin of radius q on the profile of curvature radius 1/kappa - q - clearance.
        shallow = 1.0 / (1.0 - kappa * wheel.clearance)
        radius = q * (1.0 - kappa * (q + wheel.clearance)) * shallow
        slack = max(1.0 + kappa * distance, 0.3)
        bend = kappa / slack
        third = change / (6.0 * slack * slack * slack)
        radius_slope = -q * q * shallow * shallow * change / slack
        # The foot runs along the profile by u/slack - change distance u^2 / (2 slack^3).
        second += change * change * (2.0 * wheel.clearance * shallow - distance / slack)
        radius_bend = -0.5 * q * q * shallow * shallow * second / (slack * slack)
        foot_u = ry * nx - rx * ny
        # The lobe's pitch error turns the profile, and tilts it where it leads over to the next lobe's.
        error = feet[TURNED + j]
        nx, ny = nx - error * ny, ny + error * nx
        foot_x, foot_y = lever_x - rx - (cb * run_x + sb * run_y), lever_y - ry - (cb * run_y - sb * run_x)
        slope = -feet[TURNED_SLOPE + j] * inverse_ez * ig * (foot_x * ny - foot_y * nx)
        if wheel.profile_points > 0:
            # in the wheel's own frame
            ct, st = cos_theta * cb + sin_theta * sb, cos_theta * sb - sin_theta * cb
            px, py = lever_x - (cb * run_x + sb * run_y), lever_y - (cb * run_y - sb * run_x)
            away, ax, ay = _polyline_foot(wheel, place * pitch, ct * px - st * py, st * px + ct * py)
            nx, ny = ct * ax + st * ay, ct * ay - st * ax
            gap = away - q
            slope = 0.0
            bend = 0.0
            third = 0.0
            radius_slope = 0.0
            radius_bend = 0.0
            foot_u = 0.0
        if worn > 0.0:
            gap += sink
            cosine = 1.0 / np.sqrt(1.0 + worn_slope * worn_slope)
            sine = worn_slope * cosine
            nx, ny = cosine * nx - sine * ny, cosine * ny + sine * nx
            gap, foot_u = cosine * gap + sine * foot_u, cosine * foot_u - sine * gap
            bend += worn_bend / (slack * slack)
        across_v = lever_x * nx + lever_y * ny
        across_u = lever_y * nx - lever_x * ny
        flanks[F_NX + n] = cb * nx - sb * ny
        flanks[F_NY + n] = sb * nx + cb * ny
        along_x, along_y = big_r + pins[PIN_RADIAL_ERROR + j], pins[PIN_TANGENTIAL_ERROR + j]
        flanks[F_ALONG_N + n] = along_x * nx + along_y * ny
        flanks[F_ALONG_T + n] = along_y * nx - along_x * ny
        flanks[F_V + n] = across_v
        flanks[F_U + n] = across_u - foot_u
        flanks[F_GAP + n] = gap
        flanks[F_SLOPE + n] = slope
        flanks[F_BEND + n] = bend
        flanks[F_CHANGE + n] = third
        flanks[F_RADIUS + n] = radius
        flanks[F_RADIUS_SLOPE + n] = radius_slope
        flanks[F_RADIUS_BEND + n] = radius_bend
        flanks[F_LINE_V + n] = line_x * nx + line_y * ny
        flanks[F_LINE_U + n] = line_y * nx - line_x * ny
        # v and u are zero at the foot's normal, not at the pin
        flanks[F_LINE + n] = line_value - foot_u * flanks[F_LINE_U + n]
        flanks[F_BEFORE + n] = before
        flanks[F_BEYOND + n] = beyond
        flanks[F_PIN + n] = j
        n += np.uintp(1)
    used = n - first
    while (n - first) % np.uintp(BLOCK) != 0:
        for row in range(21):
            flanks[np.uintp(row * COLUMNS) + n] = 0.0
        flanks[F_GAP + n] = 1.0
        n += np.uintp(1)
    n_edges = 0
    if has_faults:
        n_edges = _describe_edges(
            w, wheel, pins, lobes, wear, edges, theta, cos_theta, sin_theta, cx, cy, run_x, run_y, displaced
        )
    e = n_edges
    while e % BLOCK != 0:
        k = np.uintp(w * EDGE_SIZE + e)
        for row in range(18):
            edges[np.uintp(row * EDGE_COLUMNS) + k] = 0.0
        edges[E_V + k] = -2.0 * big_r - 1.0  # far away
        e += 1
    seen[own + SEEN_PHI] = phi
    seen[own + SEEN_EPS] = eps
    seen[own + SEEN_CELL] = _turn_cell(phi)
    counts[own + N_FLANKS] = n - first
    counts[own + N_EDGES] = e
    counts[own + USED_FLANKS] = used
    counts[own + USED_EDGES] = n_edges
