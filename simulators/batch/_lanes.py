"""One contact, one friction contact and one step of a state in every lane.

Everything is counted from the moment at which a contact's frame was described: small differences form before
they are rounded, so that float32 is enough. In the frame, n points out of the wheel and t is n turned by a
quarter turn; ``lever`` is the vector from the cam to the pin, (v, u) the pin's way along (n, t) since then.
"""

from __future__ import annotations

import numpy as np

from cyclofeat.simulators._jit import inner_njit
from cyclofeat.simulators.batch import _tables as rows
from cyclofeat.simulators.batch._vectors import (
    FASTMATH,
    bits_of,
    choose,
    fill_lanes,
    first_bit,
    lane_count,
    larger,
    load,
    root,
    smaller,
    store,
)

_LEAST_FORCE = 1e-30  # N; nothing is divided by zero


@inner_njit(fastmath=FASTMATH, forceinline=True)
def sine_and_fall(x):
    """Sine of x and 1 - cosine, exact to rounding in float32 for |x| < 0.6."""
    y = x * x
    sine = x - x * y * (1 / 6 - y * (1 / 120 - y * (1 / 5040 - y * (1 / 362880))))
    return sine, y * (1 / 2 - y * (1 / 24 - y * (1 / 720 - y * (1 / 40320))))


@inner_njit(fastmath=FASTMATH, forceinline=True)
def small_sine_and_fall(x):
    """As :func:`sine_and_fall`, for |x| < 0.03."""
    y = x * x
    return x - x * y * (1 / 6 - y * (1 / 120)), y * (1 / 2 - y * (1 / 24))


@inner_njit(fastmath=FASTMATH, forceinline=True)
def contact_force(depth, rate, radius, contact):
    """Normal force of one contact: never tensile, zero when open.

    ``contact`` is stiffness over the root of the radius, damping, relative damping, and one over the
    penetration over which they rise.
    """
    stiffness, damping, relative, inverse_ramp = contact
    rise = smaller(depth * inverse_ramp, 1.0)
    elastic = stiffness * depth * root(radius * depth)
    return larger(rise * (elastic + rate * (damping + relative * elastic)), 0.0)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def turned_since(turned_input, turned_eps, inverse_z):
    """Sines and cosines of the turns of wheel and cam (against the wheel) since the description.

    Returns the wheel's sine and cosine - 1, the cam's sine and cosine, and what the cam's own place adds to
    the pin's way: the difference of the cosines and the sum of the sines.
    """
    wheel = turned_eps - turned_input * inverse_z
    cam = turned_input - wheel
    square = cam * cam
    sine = wheel - wheel * (wheel * wheel) * (1 / 6)
    less = wheel * wheel * (-1 / 2)
    cam_sine = cam - cam * square * (1 / 6 - square * (1 / 120))
    cam_less = square * (square * (1 / 24) - 1 / 2)
    return sine, less, cam_sine, 1.0 + cam_less, cam_less - less, cam_sine + sine


@inner_njit(fastmath=FASTMATH, forceinline=True)
def pin_way(frame, turned):
    """Way (v, u) of the pin and the cam's centre now, in the axes of a frame."""
    lever_n, lever_t, cam_n, cam_t = frame
    sine, less, cam_sine, cam_cosine, cosines, sines = turned
    v = less * lever_n + (sine * lever_t + (sines * cam_t - cosines * cam_n))
    u = less * lever_t - (sine * lever_n + (sines * cam_n + cosines * cam_t))
    return v, u, cam_cosine * cam_n - cam_sine * cam_t, cam_cosine * cam_t + cam_sine * cam_n


@inner_njit(fastmath=FASTMATH, forceinline=True)
def flank_gap(v, u, gap, slope, bend, change):
    """Gap of a flank and its slope at the pin."""
    bent = bend - bend * bend * v
    third = change * u
    return gap + v + u * (slope + u * (bent * (1 / 2) + third * (1 / 3))), slope + u * (bent + third)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def flank_arms(frame, v, u, cam_n, cam_t, tilt):
    """Lever arms of a flank's force: of the cam's centre about the origin, of the pin about the cam."""
    along = 1.0 - tilt * tilt * (1 / 2)
    return cam_n * tilt - cam_t * along, (frame[0] + v) * tilt - (frame[1] + u) * along


@inner_njit(fastmath=FASTMATH, forceinline=True)
def flank_force(gap, u, radii, rate, contact):
    """Force of a flank; ``radii`` are the effective radius and its derivatives."""
    radius, slope, bend = radii
    return contact_force(larger(-gap, 0.0), rate, larger(radius + (slope + bend * u) * u, 0.0), contact)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def joint_sums(turn, cam, first, pitch_radius, speeds):
    """Sums over which the contacts of all sleeves of one wheel run: see :func:`sleeve_force`.

    ``turn`` is the output's angle against the holes, ``cam`` the cam's centre in the axes of the holes,
    ``first`` the direction of the first sleeve in them, ``speeds`` the rates of wheel, output and input.
    """
    square = turn * turn
    sine = turn - turn * square * (1 / 6 - square * (1 / 120))
    x = pitch_radius * (square * (square * (1 / 24 - square * (1 / 720)) - 1 / 2))
    y = pitch_radius * sine
    cam_x, cam_y = cam
    rate, rate_out, omega = speeds
    cosine, sine_first = first
    hole_x, hole_y = pitch_radius * cam_y, -(pitch_radius * cam_x)
    way_x, way_y = x * cam_y - y * cam_x, -(y * cam_y + x * cam_x)
    hole_c, hole_s = cosine * hole_x + sine_first * hole_y, cosine * hole_y - sine_first * hole_x
    way_c, way_s = cosine * way_x + sine_first * way_y, cosine * way_y - sine_first * way_x
    out_c, out_s = hole_c + way_c, hole_s + way_s
    arm = pitch_radius * y
    rates = (
        (rate_out - rate) * arm,
        rate * hole_c - rate_out * out_c + omega * way_c,
        rate * hole_s - rate_out * out_s + omega * way_s,
    )
    return -2.0 * pitch_radius * x, (hole_c, hole_s), (way_c, way_s), (out_c, out_s), arm, rates


@inner_njit(fastmath=FASTMATH, forceinline=True)
def sleeve_force(beyond, cosine, sine, rates, gap, contact):
    """Force of one sleeve over its distance from the hole's centre.

    ``beyond`` is the square of that distance less the square of the gap.
    """
    distance = root(gap * gap + beyond)
    both = distance + gap
    share = 1.0 / (distance * both)  # one quotient for two
    depth, inverse = larger(beyond * distance * share, 0.0), both * share
    rate = (rates[0] + cosine * rates[1] + sine * rates[2]) * inverse
    return contact_force(depth, rate, 1.0, contact) * inverse


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _tanh_parts(x):
    """Numbers whose quotient is the hyperbolic tangent, exact to rounding in float32."""
    x = smaller(larger(x, -10.0), 10.0) * (1 / 8)
    y = x * x
    above, below = x * (1.0 + y * (1 / 9 + y * (1 / 945))), 1.0 + y * (4 / 9 + y * (1 / 63))
    above, below = 2.0 * above * below, above * above + below * below
    above, below = 2.0 * above * below, above * above + below * below
    return 2.0 * above * below, above * above + below * below


@inner_njit(fastmath=FASTMATH, forceinline=True)
def tanh_of(x):
    """Hyperbolic tangent."""
    above, below = _tanh_parts(x)
    return above / below


@inner_njit(fastmath=FASTMATH, forceinline=True)
def sleeve_friction(slip, force, friction):
    """Coulomb, Stribeck and viscous friction of a sleeve that is pressed with a force.

    ``friction`` is the coefficient of Coulomb friction, by how much it is higher at rest, one over the speeds
    of Stribeck and of transition (the latter last), and the viscous coefficient between them.
    """
    coulomb, at_rest, inverse_stribeck, viscous, inverse_transition = friction
    ratio = slip * inverse_stribeck
    above, below = _tanh_parts(0.5 * ratio * ratio)
    coefficient = coulomb + at_rest * (below - above) / (below + above)  # exp(-2x) from tanh(x)
    viscous = choose(force > 0.0, viscous, 0.0)
    return force * coefficient * tanh_of(slip * inverse_transition) + viscous * slip


@inner_njit(fastmath=FASTMATH, forceinline=True)
def bearing_friction(speed, coulomb, viscous, inverse_transition):
    """Torque that a shaft's bearing opposes to its speed."""
    return coulomb * tanh_of(speed * inverse_transition) + viscous * speed


@inner_njit(fastmath=FASTMATH, forceinline=True)
def add_exactly(k, n, increment, table, lanes):
    """Add to a state, and keep what rounding cuts off for the next time."""
    old = load(table, k, lanes)
    whole = increment - load(table, 3 * n + k, lanes)
    new = old + whole
    store(table, 3 * n + k, (new - old) - whole)
    store(table, k, new)
    store(table, n + k, new)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def advance_state(k, n, when, rate, push, table, lanes):
    """Advance a state by half a step or a whole one; ``push`` is the drive's share of its rate.

    The table begins with four rows for each of n states: the state, the same at this evaluation, its rate at
    the last one, and what rounding cut off. ``when`` is the number of stages, if this is the second, the
    step, if it is the first, and if speeds are known half a step later than positions, as in the leapfrog
    rule: the state is such a speed. With one stage ``push`` is the change in a step.
    """
    stages, odd, dt, is_first, leaps = when
    if stages == 2:
        if odd:
            add_exactly(k, n, dt * (rate + push), table, lanes)
        else:
            store(table, n + k, load(table, k, lanes) + (0.5 * dt) * (rate + push))
    elif leaps:
        whole, ahead, behind = (0.5 * dt, 0.5 * dt, 0.0) if is_first else (dt, 0.875 * dt, 0.375 * dt)
        add_exactly(k, n, push + whole * rate, table, lanes)
        last = load(table, 2 * n + k, lanes)
        store(table, n + k, load(table, k, lanes) + (ahead * rate - behind * last))
        store(table, 2 * n + k, rate)
    else:
        # The first step has no earlier rates: Euler's rule, of second order in one step.
        before = 0.0 if is_first else 0.5 * dt
        last = load(table, 2 * n + k, lanes)
        add_exactly(k, n, push + ((dt + before) * rate - before * last), table, lanes)
        store(table, 2 * n + k, rate)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def first_normal(kind, w, tables):
    """Row of the normal of the first of a wheel's contacts of one kind."""
    n_pins = tables.n_lobes + 1
    first = rows.N_SPIN_ROWS * (n_pins + tables.n_sleeves) + 2
    per_wheel = rows.N_EDGE_KINDS * n_pins if kind == rows.EDGES else n_pins
    return np.uintp(first + rows.N_NORMAL_ROWS * (2 * kind * n_pins + w * per_wheel))


@inner_njit(fastmath=FASTMATH, forceinline=True)
def press_pin(spins, force, along, tilt, row, turned, tables, lanes):
    """Add a contact's force, its normal rotated, to that of its pin; ``row`` indexes the normal."""
    if spins is None:
        return
    nx, ny = load(spins, row, lanes), load(spins, row + 1, lanes)
    x, y = force * (along * nx - tilt * ny), force * (along * ny + tilt * nx)
    sine, less = turned[0], turned[1]
    n, width = np.uintp(tables.n_lobes + 1 + tables.n_sleeves), lane_count(lanes)
    scratch = rows.N_SPIN_ROWS * n
    store(spins, scratch, x + (less * x - sine * y))
    store(spins, scratch + 1, y + (less * y + sine * x))
    # Lanes differ in the pins that touch.
    bits = bits_of(force > 0.0)
    while bits != 0:
        lane = np.uintp(first_bit(bits))
        bits &= bits - np.uint64(1)
        pin = np.uintp(spins[(row + 2) * width + lane])
        spins[(rows.FORCE_X * n + pin) * width + lane] += spins[scratch * width + lane]
        spins[(rows.FORCE_Y * n + pin) * width + lane] += spins[(scratch + 1) * width + lane]


@inner_njit(fastmath=FASTMATH, forceinline=True)
def turn_back(vector, angle):
    """A vector in axes that are turned by an angle below 0.6."""
    sine, fall = sine_and_fall(angle)
    x, y = vector
    return x - fall * x + sine * y, y - fall * y - sine * x


@inner_njit(fastmath=FASTMATH, forceinline=True)
def press_sleeve(spins, k, over, turn, cam, tables, lanes):
    """Note the force of an internal sleeve, given over the distance to its hole's centre."""
    if spins is None:
        return
    n_pins = np.uintp(tables.n_lobes + 1)
    n = n_pins + np.uintp(tables.n_sleeves)
    sine, fall = sine_and_fall(turn)
    at = n_pins + k
    x, y = load(spins, rows.AXLE_X * n + at, lanes), load(spins, rows.AXLE_Y * n + at, lanes)
    store(spins, rows.FORCE_X * n + at, over * (fall * x - sine * y - cam[0]))
    store(spins, rows.FORCE_Y * n + at, over * (fall * y + sine * x - cam[1]))


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _rub_sleeves(spins, first, n_here, sleeve, cam, speeds, tables, lanes):
    """Moments of the friction of one kind of sleeves: on the wheel about the cam, of the cam, on the carrier.

    ``sleeve`` is the radius, negative where wheels lie outside, that sign, and the speed of the axles'
    carrier; ``cam`` is in the carrier's axes, ``speeds`` are those of wheel and input.
    """
    t, n = tables.lanes, np.uintp(tables.n_lobes + 1 + tables.n_sleeves)
    radius, side, carrier = sleeve
    rate, omega = speeds
    zero = fill_lanes(0.0, t, lanes)
    on_wheel, on_cam, on_carrier = zero, zero, zero
    friction = (
        load(t, rows.COULOMB, lanes), load(t, rows.AT_REST, lanes), load(t, rows.INVERSE_STRIBECK, lanes),
        load(t, rows.VISCOUS, lanes), load(t, rows.INVERSE_TRANSITION, lanes),
    )  # fmt: skip
    for k in range(np.uintp(first), np.uintp(first + n_here)):
        x, y = load(spins, rows.FORCE_X * n + k, lanes), load(spins, rows.FORCE_Y * n + k, lanes)
        square = x * x + y * y
        if bits_of(square > 0.0) != 0:
            force = root(square)
            inverse = 1.0 / larger(force, _LEAST_FORCE)
            nx, ny = x * inverse, y * inverse
            axle = load(spins, rows.AXLE_X * n + k, lanes) * nx + load(spins, rows.AXLE_Y * n + k, lanes) * ny
            cam_n = cam[0] * nx + cam[1] * ny
            lever = axle - cam_n + radius
            slip = omega * cam_n + rate * lever - carrier * axle - radius * load(spins, n + k, lanes)
            rub = sleeve_friction(slip, force, friction)
            on_wheel = on_wheel - rub * lever
            on_cam = on_cam - rub * cam_n
            on_carrier = on_carrier + rub * axle
            store(spins, rows.TORQUE * n + k, load(spins, rows.TORQUE * n + k, lanes) + radius * rub)
            rub = side * rub
            store(spins, rows.LOAD_X * n + k, load(spins, rows.LOAD_X * n + k, lanes) + (x + rub * ny))
            store(spins, rows.LOAD_Y * n + k, load(spins, rows.LOAD_Y * n + k, lanes) + (y - rub * nx))
            store(spins, rows.FORCE_X * n + k, zero)
            store(spins, rows.FORCE_Y * n + k, zero)
    return on_wheel, on_cam, on_carrier


@inner_njit(fastmath=FASTMATH, forceinline=True)
def friction_moments(spins, w, since, cam, speeds, tables, lanes):
    """Moments of all sleeves' friction on one wheel: on it about the cam, of the cam, and on the output.

    ``since`` is the input's turn since the description, ``cam`` in the output's axes.
    """
    t = tables.lanes
    zero = fill_lanes(0.0, t, lanes)
    if spins is None:
        return zero, zero, zero
    rate, rate_out, omega = speeds
    n_pins = tables.n_lobes + 1
    fixed = turn_back((load(t, rows.FIXED_CAM_X + w, lanes), load(t, rows.FIXED_CAM_Y + w, lanes)), -since)
    outside = (-load(t, rows.PIN_RADIUS, lanes), -1.0, zero)
    inside = (load(t, rows.SLEEVE_RADIUS, lanes), 1.0, rate_out)
    on_wheel, on_cam, _ = _rub_sleeves(spins, 0, n_pins, outside, fixed, (rate, omega), tables, lanes)
    more, of_cam, on_output = _rub_sleeves(
        spins, n_pins, tables.n_sleeves, inside, cam, (rate, omega), tables, lanes
    )
    return on_wheel + more, on_cam + of_cam, on_output


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _spin_sleeves(spins, first, n_here, sleeve, when, tables, lanes):
    """Advance the spin of one kind of sleeves; return the moment of the axles on the carrier."""
    t, n = tables.lanes, np.uintp(tables.n_lobes + 1 + tables.n_sleeves)
    radius, _, carrier = sleeve
    zero = fill_lanes(0.0, t, lanes)
    steep = radius * load(t, rows.INVERSE_TRANSITION, lanes)
    journal = load(t, rows.JOURNAL, lanes) * radius
    by_inertia = load(t, rows.BY_SLEEVE_INERTIA, lanes)
    total = zero
    for k in range(np.uintp(first), np.uintp(first + n_here)):
        x, y = load(spins, rows.LOAD_X * n + k, lanes), load(spins, rows.LOAD_Y * n + k, lanes)
        drag = journal * root(x * x + y * y) * tanh_of(steep * (load(spins, n + k, lanes) - carrier))
        rate = (load(spins, rows.TORQUE * n + k, lanes) - drag) * by_inertia
        advance_state(k, n, when, rate, zero, spins, lanes)
        total = total + drag
        store(spins, rows.LOAD_X * n + k, zero)
        store(spins, rows.LOAD_Y * n + k, zero)
        store(spins, rows.TORQUE * n + k, zero)
    return total


@inner_njit(fastmath=FASTMATH, forceinline=True)
def spin_moments(spins, rate_out, omega, when, tables, lanes):
    """Advance the spins of all sleeves; moments of axles and bearings on the output, and on the input."""
    t = tables.lanes
    zero = fill_lanes(0.0, t, lanes)
    if spins is None:
        return zero, zero
    n_pins = tables.n_lobes + 1
    outside = (-load(t, rows.PIN_RADIUS, lanes), -1.0, zero)
    inside = (load(t, rows.SLEEVE_RADIUS, lanes), 1.0, rate_out)
    _spin_sleeves(spins, 0, n_pins, outside, when, tables, lanes)
    on_output = _spin_sleeves(spins, n_pins, tables.n_sleeves, inside, when, tables, lanes)
    steep = load(t, rows.INVERSE_BEARING, lanes)
    on_output = on_output - bearing_friction(
        rate_out, load(t, rows.OUTPUT_COULOMB, lanes), load(t, rows.OUTPUT_VISCOUS, lanes), steep
    )
    return on_output, -bearing_friction(
        omega, load(t, rows.INPUT_COULOMB, lanes), load(t, rows.INPUT_VISCOUS, lanes), steep
    )
