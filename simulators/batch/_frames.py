"""Frames of all contacts of one wheel in one lane: one pin in each lane of a vector.

See :mod:`~cyclofeat.simulators._outline` for what is described, and when: here with every number counted from
the moment of the description, and the pins that touch first.
"""

from __future__ import annotations

import numpy as np

from cyclofeat.simulators._jit import inner_njit
from cyclofeat.simulators._outline import CELLS_PER_RADIAN, CHORD_ENDS, DISPLACED_REACH, FIRST_BORDER, LEAD
from cyclofeat.simulators.batch import _tables as rows
from cyclofeat.simulators.batch._lanes import first_normal, sine_and_fall, small_sine_and_fall
from cyclofeat.simulators.batch._vectors import (
    FASTMATH,
    bits_of,
    choose,
    fill_lanes,
    first_bit,
    join_lanes,
    lane_count,
    larger,
    load,
    load_from,
    magnitude,
    root,
    smaller,
    store,
    whole_below,
)

_N_DIRECTIONS = 64
_COSINES = np.cos(2 * np.pi * np.arange(_N_DIRECTIONS) / _N_DIRECTIONS)
_SINES = np.sin(2 * np.pi * np.arange(_N_DIRECTIONS) / _N_DIRECTIONS)
# Share of a pitch about the place where lobes or their halves meet, beyond which no pin passes it.
MEETING = 0.02
_LOST = 1e6  # rad; an angle beyond is no longer that of a machine


@inner_njit(fastmath=FASTMATH)
def cosine_and_sine(angle):
    """Cosine and sine of an angle, in float64: from the nearest of 64 directions."""
    turns = angle * (_N_DIRECTIONS / (2 * np.pi))
    nearest = np.floor(turns + 0.5)
    sine, fall = sine_and_fall((turns - nearest) * (2 * np.pi / _N_DIRECTIONS))
    k = np.uintp(np.int64(nearest) & (_N_DIRECTIONS - 1))
    c, s = _COSINES[k], _SINES[k]
    return c - (c * fall + s * sine), s - (s * fall - c * sine)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _at_foot(foot, displaced, lobe, g, at):
    """Vector from the foot to the pin's centre, and the factors of the profile's tangent there."""
    dx, dy = displaced
    qx, qy = lobe
    e, inverse_m, n_pins = g[at + rows.ECCENTRICITY], g[at + rows.INVERSE_M], g[at + rows.N_PINS]
    s1, v1 = small_sine_and_fall(foot)
    s2, v2 = sine_and_fall(foot * n_pins)
    fall_x, fall_y = v2 * qx + s2 * qy, v2 * qy - s2 * qx
    rx = dx + g[at + rows.CIRCLE_RADIUS] * v1 + e * fall_x
    ry = dy - g[at + rows.CIRCLE_RADIUS] * s1 + e * fall_y
    wx, wy = qx - fall_x, qy - fall_y
    return s1, v1, rx, ry, wx, wy, inverse_m - v1 * inverse_m + wx, s1 * inverse_m + wy


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _next_foot(foot, rx, ry, wx, wy, hx, hy, g, at):
    """Newton's step to the foot of a pin's normal on the profile."""
    inverse_ez, z, largest = g[at + rows.INVERSE_EZ], g[at + rows.Z], g[at + rows.LARGEST_STEP]
    flat = hx * hx + hy * hy
    slope = flat + (rx * (hx + z * wx) + ry * (hy + z * wy)) * inverse_ez
    foot = foot + (ry * hx - rx * hy) * inverse_ez / larger(slope, 0.3 * flat)
    return smaller(larger(foot, -largest), largest)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _profile_at(at_foot, g, at):
    """Normal, and gap and effective radius with their derivatives along the tangent, at a pin."""
    s1, v1, rx, ry, _, _, hx, hy = at_foot
    inverse = 1.0 / root(hx * hx + hy * hy)
    square = inverse * inverse
    nx, ny = hx * inverse, hy * inverse
    distance, foot_u = rx * nx + ry * ny, ry * nx - rx * ny
    curve_1, clearance, q = g[at + rows.CURVE_1], g[at + rows.CLEARANCE], g[at + rows.RADIUS]
    cubic = g[at + rows.CURVE_3] * square
    kappa = (curve_1 + cubic) * inverse
    sine = g[at + rows.STEEPNESS] * (hy - v1 * hy - s1 * hx)
    cosine = hx - v1 * hx + s1 * hy - g[at + rows.INVERSE_M]
    fourth = (curve_1 + 3.0 * cubic) * (square * square)
    change = fourth * sine
    second = (4.0 * curve_1 + 18.0 * cubic) * (sine * sine) * (square * square) * (square * inverse)
    second = second + fourth * g[at + rows.STEEPNESS_CHANGE] * cosine * inverse
    shallow = 1.0 / (1.0 - kappa * clearance)
    slack = 1.0 / larger(1.0 + kappa * distance, 0.3)
    second = second + change * change * (2.0 * clearance * shallow - distance * slack)
    square_q = q * q * shallow * shallow * slack
    bend, third = kappa * slack, change * 0.5 * slack * slack * slack
    # All derivatives at the pin, which lies foot_u beside the normal.
    gaps = (
        distance + clearance + foot_u * foot_u * (0.5 * bend + third * foot_u * (1 / 3)),
        foot_u * (bend + third * foot_u),
        bend + 2.0 * third * foot_u,
        third,
    )
    radius_slope, radius_bend = -(square_q * change), -(0.5 * square_q * second * slack)
    radii = (
        q * (1.0 - kappa * (q + clearance)) * shallow + (radius_slope + radius_bend * foot_u) * foot_u,
        radius_slope + 2.0 * radius_bend * foot_u,
        radius_bend,
    )
    return nx, ny, gaps, radii


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _per_wheel(values, table, half):
    """The vector with one number for the pins of each wheel."""
    return join_lanes(fill_lanes(values[0], table, half), fill_lanes(values[1], table, half))


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _of_pins(table, row, half):
    """A row of the pins, for each wheel."""
    values = load(table, row, half)
    return join_lanes(values, values)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _load_weights(weights, first, shift, half):
    return join_lanes(load_from(weights, first[0] + shift, half), load_from(weights, first[1] + shift, half))


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _write_normal(spins, row, normal, axes, frames, n_blocks, b):
    """Write a normal in fixed axes: only friction needs it."""
    if spins is None:
        return
    nx, ny = normal
    c, s = axes
    store(frames, row * n_blocks + b, c * nx - s * ny)
    store(frames, (row + 1) * n_blocks + b, s * nx + c * ny)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _write_frame(row, pin, normal, frames, n_blocks, b):
    """Write lever and cam of a contact along its normal and tangent, from a row on."""
    lever, cam, _ = pin
    nx, ny = normal
    store(frames, row * n_blocks + b, lever[0] * nx + lever[1] * ny)
    store(frames, (row + 1) * n_blocks + b, lever[1] * nx - lever[0] * ny)
    store(frames, (row + 2) * n_blocks + b, cam[0] * nx + cam[1] * ny)
    store(frames, (row + 3) * n_blocks + b, cam[1] * nx - cam[0] * ny)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _edge_frames(kind, angle, share, side, arm, beyond_tip, pin, reach, tables, at, b):
    """Frames of one kind of edges, and the masks of those that touch and of those only in reach.

    ``angle`` is of the pin against the tip, ``arm`` the vector from the profile to it, ``beyond_tip`` the
    radial part of that from the tip at the pin's own angle.
    """
    g, frames, n_blocks = tables.rounded, tables.frames, tables.n_blocks
    _, _, axes = pin
    sine, fall = sine_and_fall(angle)
    from_x = beyond_tip - fall * arm[0] - sine * arm[1] - g[at + rows.EDGE_X + kind]
    from_y = sine * arm[0] + (arm[1] - fall * arm[1]) - g[at + rows.EDGE_Y + kind]
    nx, ny = g[at + rows.EDGE_NX + kind], g[at + rows.EDGE_NY + kind]
    v, u = from_x * nx + from_y * ny, from_y * nx - from_x * ny
    aside = smaller(u, 0.0) if kind == rows.ON_CHORD else u
    square, q = v * v + aside * aside, g[at + rows.RADIUS]
    near = (square < (q + reach) * (q + reach)) & (v >= -reach) & (share > 0.0)
    touching = square < q * q
    tables.bits[(rows.ON_EDGE + kind) * n_blocks + b] = bits_of(near & touching)
    tables.bits[(rows.NEAR_EDGE + kind) * n_blocks + b] = bits_of(near & ~touching)
    if bits_of(near) != 0:
        row = rows.EDGE_FRAMES + rows.N_EDGE_ROWS * kind
        x, y = nx - fall * nx + sine * ny, ny - fall * ny - sine * nx
        _write_normal(tables.spins, rows.EDGE_NORMALS + 2 * kind, (x, y), axes, frames, n_blocks, b)
        _write_frame(row, pin, (x, y), frames, n_blocks, b)
        store(frames, (row + rows.E_OVER) * n_blocks + b, v - q)
        store(frames, (row + rows.E_ALONG) * n_blocks + b, u)
        store(frames, (row + rows.E_WEIGHT) * n_blocks + b, share)
        store(frames, (row + rows.E_SIDE) * n_blocks + b, side)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _places_of_weights(place, b, lane, tables, half):
    """Index of the first pin's weights on each wheel, two lobes before its own, and the pins' way over it."""
    n_places = np.uintp(tables.n_lobes + 4) + np.uintp(tables.n_blocks) * lane_count(half)
    base = (np.floor(-place[0]), np.floor(-place[1]))
    block = np.uintp(b) * lane_count(half) + np.uintp(2 * rows.N_WEIGHTS) * lane * n_places
    first = block + np.uintp(np.int64(base[0]) + tables.n_lobes)
    second = block + np.uintp(np.int64(base[1]) + tables.n_lobes) + np.uintp(rows.N_WEIGHTS) * n_places
    share = _of_pins(tables.pins, rows.PIN_SHARE * tables.n_blocks + b, half)
    over = _per_wheel((-place[0] - base[0], -place[1] - base[1]), tables.frames, half) - share
    return (first, second), n_places, over


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _lobe_value(kind, index, n_places, step, tables, half):
    """A weight of the lobes a step of -2 to 1 after those of an index for each wheel."""
    weights, shift = tables.weights, np.uintp(kind) * n_places
    index = (index[0] + shift, index[1] + shift)
    before = choose(
        step < -1.5,
        _load_weights(weights, index, np.uintp(0), half),
        _load_weights(weights, index, np.uintp(1), half),
    )
    after = choose(
        step < 0.5,
        _load_weights(weights, index, np.uintp(2), half),
        _load_weights(weights, index, np.uintp(3), half),
    )
    return choose(step < -0.5, before, after)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _lobe_error(pitched, index, n_places, step, tables, half):
    """Pitch error of the lobes a step after those of an index for each wheel."""
    if pitched is None:
        return _per_wheel((0.0, 0.0), tables.frames, half)
    return _lobe_value(rows.PITCH_ERROR, index, n_places, step, tables, half)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _turn_back_pins(pitched, b, wheels, displaced, cam, lane, tables, half):
    """Angle by which the profile is displaced at each pin, its slope by share of a pitch, and the pins' ways.

    The way of a pin from the rest position is turned back by the angle.
    """
    if pitched is None:
        none = _per_wheel((0.0, 0.0), tables.frames, half)
        return (none, none), displaced
    places = (wheels[0].place, wheels[1].place)
    index, n_places, over = _places_of_weights(places, b, lane, tables, half)
    step = whole_below(over)
    here = _lobe_error(pitched, index, n_places, step, tables, half)
    change = _lobe_error(pitched, index, n_places, step + 1.0, tables, half) - here
    # The half from tip to pit is displaced as a whole; the other half passes smoothly to the next lobe.
    x = larger(2.0 * (over - step) - 1.0, 0.0)
    error = here + change * x * x * (3.0 - 2.0 * x)
    circle = tables.rounded[lane * np.uintp(rows.N_COLUMNS) + rows.CIRCLE_RADIUS]
    displaced = (displaced[0] - error * cam[1], displaced[1] - error * (circle - cam[0]))
    return (error, change * 12.0 * x * (1.0 - x)), displaced


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _from_profile(pin, wheels, table, half):
    """Run-out of the profiles in the pins' own frames, and the vectors from the profiles to the pins."""
    lever, _, (c, s) = pin
    x = _per_wheel((wheels[0].run_x, wheels[1].run_x), table, half)
    y = _per_wheel((wheels[0].run_y, wheels[1].run_y), table, half)
    run = (c * x + s * y, c * y - s * x)
    return run, (lever[0] - run[0], lever[1] - run[1])


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _tilt_flank(pitched, errors, normal, gaps, at_foot, pin, wheels, tables, at, half):
    """Normal and gap of a profile that a pitch error turns, and tilts where it leads to the next lobe's."""
    if pitched is None:
        return normal, gaps
    error, slope = errors
    nx, ny = normal
    _, _, rx, ry, _, _, hx, hy = at_foot
    foot_u = ry * nx - rx * ny
    nx, ny = nx - error * ny, ny + error * nx
    _, arm = _from_profile(pin, wheels, tables.frames, half)
    foot_x, foot_y = arm[0] - rx, arm[1] - ry
    along = tables.rounded[at + rows.PER_PITCH] * tables.rounded[at + rows.INVERSE_EZ]
    tilt = slope * along * (foot_y * nx - foot_x * ny) / root(hx * hx + hy * hy)
    return (nx, ny), (gaps[0] + tilt * foot_u, gaps[1] + tilt, gaps[2], gaps[3])


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _wear_at(b, foot, at_foot, places, lane, tables, half):
    """Radial wear at the feet of pins, and its slope and curvature along the profile."""
    g, at = tables.rounded, lane * np.uintp(rows.N_COLUMNS)
    index, n_places, over = _places_of_weights(places, b, lane, tables, half)
    over = over + foot * g[at + rows.PER_PITCH]
    step = whole_below(over)
    depth = _lobe_value(rows.RADIAL, index, n_places, step, tables, half)
    by_width = g[at + rows.WEAR_BY_WIDTH]
    # From the middle of the wear on, where the cosine is 1.
    share = smaller(larger((over - step - g[at + rows.WEAR_MIDDLE]) * by_width, -0.5), 0.5)
    sine, fall = sine_and_fall(share * (np.pi / 4))
    cosine = 1.0 - fall
    for _ in range(3):
        sine, cosine = 2.0 * sine * cosine, cosine * cosine - sine * sine
    raised = 0.5 * (1.0 + cosine)
    s1, v1, _, _, _, _, hx, hy = at_foot
    square = 1.0 / (hx * hx + hy * hy)
    inverse = root(square)
    rate = (2 * np.pi * by_width * g[at + rows.PER_PITCH] * g[at + rows.INVERSE_EZ]) * inverse
    growth = g[at + rows.STEEPNESS] * (v1 * hy + s1 * hx - hy) * square * inverse
    slope = -(depth * rate * raised * sine)
    bend = depth * rate * rate * (0.5 * sine * sine - raised * cosine) - slope * growth
    return depth * raised * raised, slope, bend


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _beside_path(sink, slope, at_foot, g, at):
    """Place of the pins in the frame of the profile, and the slope of the path of pins over radial wear.

    The place is the height above that path along the normal, the way along the tangent, the height above
    the trochoid and its curvature.
    """
    _, _, rx, ry, _, _, hx, hy = at_foot
    square = 1.0 / (hx * hx + hy * hy)
    inverse = root(square)
    kappa = (g[at + rows.CURVE_1] + g[at + rows.CURVE_3] * square) * inverse
    depth = sink + g[at + rows.CLEARANCE]
    above = (rx * hx + ry * hy) * inverse
    return (above + depth, (ry * hx - rx * hy) * inverse, above, kappa), slope / (1.0 - kappa * depth)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _worn_foot(b, foot, at_foot, displaced, lobe, places, lane, tables, half):
    """Foot on the path of pins over radial wear, by one more of Newton's steps, and the profile there."""
    g, at = tables.rounded, lane * np.uintp(rows.N_COLUMNS)
    sink, slope, bend = _wear_at(b, foot, at_foot, places, lane, tables, half)
    (height, beside, above, kappa), tilt = _beside_path(sink, slope, at_foot, g, at)
    way = (beside - height * tilt) / (1.0 + kappa * above + height * bend + tilt * tilt)
    hx, hy = at_foot[6], at_foot[7]
    foot = foot + way * g[at + rows.INVERSE_EZ] / root(hx * hx + hy * hy)
    return foot, _at_foot(foot, displaced, lobe, g, at)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _wear_flank(b, flank, foot, at_foot, places, lane, tables, half):
    """Normal, gaps and radii of flanks with radial wear; ``flank`` holds those of the healthy flanks."""
    (nx, ny), gaps, radii = flank
    g, at = tables.rounded, lane * np.uintp(rows.N_COLUMNS)
    sink, slope, bend = _wear_at(b, foot, at_foot, places, lane, tables, half)
    (height, beside, above, kappa), tilt = _beside_path(sink, slope, at_foot, g, at)
    slack = 1.0 / larger(1.0 + kappa * above, 0.3)
    bend = gaps[2] + bend * slack * slack
    cosine = 1.0 / root(1.0 + tilt * tilt)
    sine = tilt * cosine
    left = cosine * beside - sine * height
    is_worn = sink > 0.0
    # The radius is that of the worn foot, which lies beside the pin.
    back = choose(is_worn, beside, 0.0)
    return (
        (cosine * nx - sine * ny, cosine * ny + sine * nx),
        (
            choose(is_worn, cosine * height + sine * beside, gaps[0]),
            choose(is_worn, left * bend, gaps[1]),
            bend,
            gaps[3],
        ),
        (radii[0] - (radii[1] - radii[2] * back) * back, radii[1] - 2.0 * radii[2] * back, radii[2]),
    )


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _describe_defects(b, gap, foot, place, arm, beyond_tip, pin, normal, reaches, lane, tables, half):
    """Weights and lines of the flanks, and all edges, of the pins in block ``b``.

    Returns the weights and the masks of the flanks in reach, and of those that a line may cross.
    """
    g, at, frames, n_blocks = tables.rounded, lane * np.uintp(rows.N_COLUMNS), tables.frames, tables.n_blocks
    reach, line_reach, edge_reach = reaches
    index, n_places, over = _places_of_weights(place, b, lane, tables, half)
    one, zero = _per_wheel((1.0, 1.0), frames, half), _per_wheel((0.0, 0.0), frames, half)
    step = whole_below(over)
    part = over - step
    part_of_foot = part + foot * g[at + rows.PER_PITCH]
    further = whole_below(part_of_foot)
    at_half = part_of_foot - further
    middle = (at_half >= 0.25) & (at_half < 0.75)
    further = further + choose(at_half >= 0.75, one, 0.0)
    # The next place where lobes or their halves meet lies behind the pin, or ahead of it.
    passed = (at_half < 0.25) | ((at_half >= 0.5) & (at_half < 0.75))
    ahead = step + further
    first = _lobe_value(rows.FIRST_HALF, index, n_places, ahead, tables, half)
    behind = ahead - choose(middle, zero, 1.0)
    second = _lobe_value(rows.SECOND_HALF, index, n_places, behind, tables, half)
    before, beyond = choose(middle, first, second), choose(middle, second, first)
    weight = choose(passed, beyond, before)
    used = gap < reach
    lined = used & ~used
    from_meeting = 0.25 - magnitude(magnitude(at_half - 0.5) - 0.25)
    uneven = used & (from_meeting < MEETING) & (magnitude(before - beyond) > 0.0)
    if bits_of(uneven) != 0:
        error = _lobe_error(tables.pitched, index, n_places, ahead, tables, half)
        # The line across a flank where the outline may pass into a defect, from the tip of the lobe ahead.
        angle = (part - further) * g[at + rows.PITCH] - error
        sine, fall = sine_and_fall(angle)
        along_x = choose(middle, -g[at + rows.EDGE_NY + rows.AT_PIT], 0.0 * angle)
        along_y = choose(middle, g[at + rows.EDGE_NX + rows.AT_PIT], 0.0 * angle + 1.0)
        x = along_x - fall * along_x + sine * along_y
        y = along_y - fall * along_y - sine * along_x
        nx, ny = normal
        line = arm[0] * x + arm[1] * y - choose(middle, g[at + rows.PIT_DOT], 0.0 * angle)
        store(frames, rows.F_LINE * n_blocks + b, line)
        store(frames, rows.F_LINE_V * n_blocks + b, x * nx + y * ny)
        store(frames, rows.F_LINE_U * n_blocks + b, y * nx - x * ny)
        store(frames, rows.F_BEYOND * n_blocks + b, beyond)
        lined = uneven & (magnitude(line) < line_reach)
        weight = choose(lined, before, weight)
    used = used & ~lined & (weight > 0.0)
    # Chord and pit of the lobe to which the pin at rest belongs, and the nearest tip.
    up = choose(part >= 1.0 - LEAD, one, 0.0)
    share = _lobe_value(rows.CHORD, index, n_places, step + up, tables, half)
    share = choose(part - up <= CHORD_ENDS, share, 0.0)
    side = zero
    for kind in range(rows.N_EDGE_KINDS):
        if kind == rows.AT_PIT:
            side = -one
        elif kind == rows.ON_TIP:
            up = choose(part >= 0.5, one, 0.0)
            side = 2.0 * _lobe_value(rows.TIP, index, n_places, step + up, tables, half)
            share = magnitude(side) * 0.5
        tables.bits[(rows.ON_EDGE + kind) * n_blocks + b] = np.uint64(0)
        tables.bits[(rows.NEAR_EDGE + kind) * n_blocks + b] = np.uint64(0)
        if bits_of(share > 0.0) != 0:
            error = _lobe_error(tables.pitched, index, n_places, step + up, tables, half)
            angle = (part - up) * g[at + rows.PITCH] - error
            _edge_frames(kind, angle, share, side, arm, beyond_tip, pin, edge_reach, tables, at, b)
    return weight, used, lined


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _frames_of_pins(b, first, second, faulty, lane, tables, half):
    """Frames of the pins in block ``b`` of both wheels: writes the working memory."""
    g, at = tables.rounded, lane * np.uintp(rows.N_COLUMNS)
    frames, pins, n_blocks = tables.frames, tables.pins, tables.n_blocks
    pins_at = (3 + 2 * np.int64(lane)) * n_blocks + b
    c = _of_pins(pins, rows.PIN_COS * n_blocks + b, half)
    s = _of_pins(pins, rows.PIN_SIN * n_blocks + b, half)
    radial, tangential = _of_pins(pins, pins_at, half), _of_pins(pins, pins_at + n_blocks, half)
    offset_x = _per_wheel((first.offset_x, second.offset_x), frames, half)
    offset_y = _per_wheel((first.offset_y, second.offset_y), frames, half)
    cam_x = _per_wheel((first.cam_x, second.cam_x), frames, half)
    cam_y = _per_wheel((first.cam_y, second.cam_y), frames, half)
    lobe_x = _per_wheel((first.lobe_x, second.lobe_x), frames, half)
    lobe_y = _per_wheel((first.lobe_y, second.lobe_y), frames, half)
    # Each pin in its own frame: radial, tangential.
    displaced = (c * offset_x + s * offset_y + radial, c * offset_y - s * offset_x + tangential)
    lobe = (c * lobe_x + s * lobe_y, c * lobe_y - s * lobe_x)
    cam = (c * cam_x + s * cam_y, c * cam_y - s * cam_x)
    lever = (g[at + rows.CIRCLE_RADIUS] + (radial - cam[0]), tangential - cam[1])
    pin, wheels = (lever, cam, (c, s)), (first, second)
    errors, displaced = _turn_back_pins(tables.pitched, b, wheels, displaced, cam, lane, tables, half)
    close = first.displaced < g[at + rows.CLOSE] and second.displaced < g[at + rows.CLOSE]
    # Newton's first step begins at rest, where all sines are zero.
    (dx, dy), (qx, qy) = displaced, lobe
    foot = _next_foot(0.0 * dx, dx, dy, qx, qy, g[at + rows.INVERSE_M] + qx, qy, g, at)
    if not close:
        _, _, rx, ry, wx, wy, hx, hy = _at_foot(foot, displaced, lobe, g, at)
        foot = _next_foot(foot, rx, ry, wx, wy, hx, hy, g, at)
    at_foot = _at_foot(foot, displaced, lobe, g, at)
    places, is_worn = (first.place, second.place), g[at + rows.WEAR_BY_WIDTH] > 0.0
    if is_worn:
        foot, at_foot = _worn_foot(b, foot, at_foot, displaced, lobe, places, lane, tables, half)
    nx, ny, gaps, radii = _profile_at(at_foot, g, at)
    normal, gaps = _tilt_flank(tables.pitched, errors, (nx, ny), gaps, at_foot, pin, wheels, tables, at, half)
    healthy_gap = gaps[0]
    if is_worn:
        flank = (normal, gaps, radii)
        normal, gaps, radii = _wear_flank(b, flank, foot, at_foot, places, lane, tables, half)
    if g[at + rows.CONSTANT_RADIUS] > 0.0:
        constant = _per_wheel((g[at + rows.CONSTANT_RADIUS], g[at + rows.CONSTANT_RADIUS]), frames, half)
        radii = (constant, 0.0 * constant, 0.0 * constant)
    _write_frame(rows.F_LEVER_N, pin, normal, frames, n_blocks, b)
    store(frames, rows.F_GAP * n_blocks + b, gaps[0])
    store(frames, rows.F_SLOPE * n_blocks + b, gaps[1])
    store(frames, rows.F_BEND * n_blocks + b, gaps[2])
    store(frames, rows.F_CHANGE * n_blocks + b, gaps[3])
    store(frames, rows.F_RADIUS * n_blocks + b, radii[0])
    store(frames, rows.F_RADIUS_SLOPE * n_blocks + b, radii[1])
    store(frames, rows.F_RADIUS_BEND * n_blocks + b, radii[2])
    _write_normal(tables.spins, rows.FLANK_NORMALS, normal, (c, s), frames, n_blocks, b)
    wider = DISPLACED_REACH * _per_wheel((first.displaced, second.displaced), frames, half)
    reach = g[at + rows.FLANK_REACH] + wider
    weight = _per_wheel((1.0, 1.0), frames, half)
    used = healthy_gap < reach
    lined = used & ~used
    if faulty:
        run, arm = _from_profile(pin, wheels, frames, half)
        beyond_tip = g[at + rows.TIP_LESS] + (radial - cam[0] - run[0])
        weight, used, lined = _describe_defects(
            b, healthy_gap, foot, places, arm, beyond_tip, pin, normal,
            (reach, g[at + rows.LINE_REACH] + wider, g[at + rows.EDGE_REACH] + wider), lane, tables, half,
        )  # fmt: skip
    store(frames, rows.F_WEIGHT * n_blocks + b, weight)
    touching = gaps[0] < 0.0
    bits = tables.bits
    bits[rows.TOUCHING * n_blocks + b] = bits_of(used & touching)
    bits[rows.OPEN * n_blocks + b] = bits_of(used & ~touching)
    bits[rows.LINED * n_blocks + b] = bits_of(lined)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _contact_table(kind, w, lane, tables, lanes):
    """Table of a lane's contacts of a kind, the index of the first there, and the rows of each."""
    width, n_pins = lane_count(lanes), np.uintp(w * (tables.n_lobes + 1))
    table, n_rows, first = tables.flanks, np.uintp(rows.N_FLANK_ROWS), n_pins
    if kind == rows.LINED_FLANKS:
        table, n_rows = tables.lined, np.uintp(rows.N_LINED_ROWS)
    elif kind == rows.EDGES:
        table, n_rows, first = tables.edges, np.uintp(rows.N_EDGE_ROWS), np.uintp(rows.N_EDGE_KINDS) * n_pins
    return table, first * n_rows * width + lane, n_rows


@inner_njit(fastmath=FASTMATH)
def _pack_contacts(spins, mask, row, row_of_normals, kind, w, n, lane, tables, lanes, half):
    """Copy a mask's pins, from a row of their frames on, to a lane's contacts from number ``n`` on.

    Returns the next number. Only friction needs the normals.
    """
    frames, n_blocks, width = tables.frames, tables.n_blocks, lane_count(lanes)
    per_block = np.uintp(2) * lane_count(half)
    stride = np.uintp(n_blocks) * per_block
    table, into, n_rows = _contact_table(kind, w, lane, tables, lanes)
    for b in range(n_blocks):
        # The last block may not be full.
        n_here = min(tables.n_lobes + 1 - b * np.int64(lane_count(half)), np.int64(lane_count(half)))
        bits = tables.bits[mask * n_blocks + b] >> np.uint64(w * np.int64(lane_count(half)))
        bits &= (np.uint64(1) << np.uint64(n_here)) - np.uint64(1)
        while bits != 0:
            bit = np.uintp(first_bit(bits))
            bits &= bits - np.uint64(1)
            pin = bit + np.uintp(w) * lane_count(half) + np.uintp(b) * per_block
            if spins is not None:
                normal = (first_normal(kind, w, tables) + np.uintp(rows.N_NORMAL_ROWS) * n) * width + lane
                spins[normal] = frames[np.uintp(row_of_normals) * stride + pin]
                spins[normal + width] = frames[np.uintp(row_of_normals + 1) * stride + pin]
                spins[normal + 2 * width] = bit + np.uintp(b) * lane_count(half)
            to = into + n * n_rows * width
            pin += np.uintp(row) * stride
            # Four rows at a time: of a loop over single rows the compiler makes gathers.
            for _ in range(n_rows // np.uintp(4)):
                table[to] = frames[pin]
                table[to + width] = frames[pin + stride]
                table[to + 2 * width] = frames[pin + 2 * stride]
                table[to + 3 * width] = frames[pin + 3 * stride]
                to += np.uintp(4) * width
                pin += np.uintp(4) * stride
            n += np.uintp(1)
    return n


@inner_njit(fastmath=FASTMATH)
def keep_first(kind, w, lane, n, tables, lanes):
    """Truncate a lane to ``n`` contacts of a kind: open or unweight the rest."""
    width = lane_count(lanes)
    here = np.uintp(rows.N_FLANKS + 2 * kind + w) * width + lane
    had = np.uintp(tables.lanes[here])
    tables.lanes[here] = n
    table, into, n_rows = _contact_table(kind, w, lane, tables, lanes)
    for k in range(n, had):
        to = into + k * n_rows * width
        if kind == rows.EDGES:
            table[to + rows.E_WEIGHT * width] = 0.0
        else:
            table[to + rows.F_GAP * width] = 1.0
            table[to + rows.F_BEND * width] = 0.0


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _wheel_place(w, eps, hole, around, lane, g):
    """Place of wheel ``w``: all that its pins' frames need."""
    at = lane * np.uintp(rows.N_COLUMNS)
    by_wheel = at + np.uintp(w)
    z, e = g[at + rows.Z], g[at + rows.ECCENTRICITY]
    cos_phi, sin_phi = around
    cos_hole, sin_hole = cosine_and_sine(hole)
    side = 1.0 - 2.0 * w
    sine, fall = sine_and_fall(z * eps)
    # exp(-i z theta) = -exp(i phi_w) exp(-i z eps), phi_w the angle of the wheel's own cam.
    lobe_x = -side * (cos_phi - cos_phi * fall + sin_phi * sine)
    lobe_y = -side * (sin_phi - sin_phi * fall - cos_phi * sine)
    x = g[by_wheel + rows.CAM_LESS] + side * e * fall
    y = g[by_wheel + rows.CAM_0Y] + side * e * sine
    cos_rest, sin_rest = g[by_wheel + rows.REST_COS], g[by_wheel + rows.REST_SIN]
    cos_theta = cos_hole * cos_rest - sin_hole * sin_rest
    sin_theta = sin_hole * cos_rest + cos_hole * sin_rest
    run_0x, run_0y = g[by_wheel + rows.RUNOUT_X], g[by_wheel + rows.RUNOUT_Y]
    run_x, run_y = cos_theta * run_0x - sin_theta * run_0y, sin_theta * run_0x + cos_theta * run_0y
    offset_x = -(cos_phi * x - sin_phi * y) - run_x
    offset_y = -(sin_phi * x + cos_phi * y) - run_y
    cam_0x, cam_0y = g[by_wheel + rows.CAM_0X], g[by_wheel + rows.CAM_0Y]
    cam_x, cam_y = cos_phi * cam_0x - sin_phi * cam_0y, sin_phi * cam_0x + cos_phi * cam_0y
    place = hole * g[at + rows.PER_PITCH] + g[by_wheel + rows.REST_PLACE]
    return rows.Wheel(
        offset_x, offset_y, cam_x, cam_y, lobe_x, lobe_y, run_x, run_y,
        np.sqrt(offset_x * offset_x + offset_y * offset_y), place - z * np.floor(place / z),
        cam_x * cos_hole + cam_y * sin_hole, cam_y * cos_hole - cam_x * sin_hole,
    )  # fmt: skip


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _write_wheel(spins, w, wheel, eps, from_hole, lane, tables, lanes):
    """Write what the time loop needs of a wheel besides its contacts."""
    width, n = lane_count(lanes), tables.n_sleeves
    mine = np.uintp(w) * width + lane
    lane_rows = tables.lanes
    lane_rows[rows.SEEN_EPS * width + mine] = eps
    lane_rows[rows.CAM_X * width + mine] = wheel.hole_cam_x
    lane_rows[rows.CAM_Y * width + mine] = wheel.hole_cam_y
    lane_rows[rows.FIXED_CAM_X * width + mine] = wheel.cam_x
    lane_rows[rows.FIXED_CAM_Y * width + mine] = wheel.cam_y
    # Sleeves are counted from that at the cam, for the same touch in all lanes; those that spin keep theirs.
    nearest = np.int64(0)
    if spins is None:
        nearest = np.int64(np.floor((from_hole + np.pi * w) / (2 * np.pi) * n + 0.5)) % n
    lane_rows[rows.FIRST_COS * width + mine] = tables.sleeves[nearest]
    lane_rows[rows.FIRST_SIN * width + mine] = tables.sleeves[n + nearest]


@inner_njit(fastmath=FASTMATH)
def describe_lane(lane, phi, tables, lanes, half):
    """Describe all contacts of both wheels in a lane; return False for one too far displaced for it."""
    width = lane_count(lanes)
    at = lane * np.uintp(rows.N_COLUMNS)
    g, lane_rows, spins = tables.geometry, tables.lanes, tables.spins
    eps_0 = np.float64(lane_rows[rows.AT * width + lane])
    eps_1 = np.float64(lane_rows[(rows.AT + 1) * width + lane])
    z = g[at + rows.Z]
    if not (abs(z * eps_0) < 0.5 and abs(z * eps_1) < 0.5 and abs(phi) < _LOST):
        return False
    around = cosine_and_sine(phi)
    first = _wheel_place(0, eps_0, eps_0 - phi / z, around, lane, g)
    second = _wheel_place(1, eps_1, eps_1 - phi / z, around, lane, g)
    if not (first.displaced < g[at + rows.NEAR] and second.displaced < g[at + rows.NEAR]):
        return False
    faulty = g[at + rows.HAS_FAULTS] + g[at + rows.HAS_FAULTS + 1] != 0.0
    for b in range(tables.n_blocks):
        _frames_of_pins(b, first, second, faulty, lane, tables, half)
    for w in range(tables.n_wheels):
        # First those that touch.
        n, kind = np.uintp(0), rows.FLANKS
        for mask in (rows.TOUCHING, rows.OPEN):
            n = _pack_contacts(spins, mask, 0, rows.FLANK_NORMALS, kind, w, n, lane, tables, lanes, half)
        keep_first(kind, w, lane, n, tables, lanes)
        if not faulty:
            continue
        n, kind = np.uintp(0), rows.LINED_FLANKS
        n = _pack_contacts(spins, rows.LINED, 0, rows.FLANK_NORMALS, kind, w, n, lane, tables, lanes, half)
        keep_first(kind, w, lane, n, tables, lanes)
        n = np.uintp(0)
        for mask in range(rows.ON_EDGE, rows.N_MASKS):
            edge = (mask - rows.ON_EDGE) % rows.N_EDGE_KINDS
            n = _pack_contacts(
                spins, mask, rows.EDGE_FRAMES + rows.N_EDGE_ROWS * edge, rows.EDGE_NORMALS + 2 * edge,
                rows.EDGES, w, n, lane, tables, lanes, half,
            )  # fmt: skip
        keep_first(rows.EDGES, w, lane, n, tables, lanes)
    _write_wheel(tables.spins, 0, first, eps_0, phi + phi / z - eps_0, lane, tables, lanes)
    _write_wheel(tables.spins, 1, second, eps_1, phi + phi / z - eps_1, lane, tables, lanes)
    cell = np.floor(phi * CELLS_PER_RADIAN + FIRST_BORDER) - FIRST_BORDER
    tables.seen_phi[lane] = phi
    lane_rows[rows.AHEAD * width + lane] = (cell + 1.0) / CELLS_PER_RADIAN - phi
    lane_rows[rows.BEHIND * width + lane] = cell / CELLS_PER_RADIAN - phi
    return True
