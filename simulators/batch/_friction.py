"""Friction of sleeves on wheels and axles and of the shafts' bearings, and the sleeves' spin, in all lanes.

As in the exact kernel: the forces of all contacts of a sleeve with a wheel are added first. Where no lane has
friction, ``tables.spins`` is None and nothing of this is compiled.
"""

from __future__ import annotations

import numpy as np

from cyclofeat.simulators._jit import inner_njit
from cyclofeat.simulators.batch import _rows as rows
from cyclofeat.simulators.batch._lanes import bearing_friction, sine_and_fall, sleeve_friction, tangent
from cyclofeat.simulators.batch._steps import adams_bashforth, midpoint
from cyclofeat.simulators.batch._vectors import (
    FASTMATH,
    bits_of,
    count,
    filled,
    first_bit,
    larger,
    load,
    root,
    store,
)

_LEAST_FORCE = 1e-30  # N; nothing is divided by zero


@inner_njit(fastmath=FASTMATH, forceinline=True)
def first_normal(kind, w, tables):
    """Row of the normal of the first of a wheel's contacts of one kind."""
    n_pins = tables.n_lobes + 1
    first = rows.N_SPIN_ROWS * (n_pins + tables.n_sleeves) + 2
    per_wheel = rows.N_EDGE_KINDS * n_pins if kind == rows.EDGES else n_pins
    return np.uintp(first + rows.N_NORMAL_ROWS * (2 * kind * n_pins + w * per_wheel))


@inner_njit(fastmath=FASTMATH, forceinline=True)
def press(spins, force, along, tilt, row, turned, tables, lanes):
    """Add a contact's force to that of its pin; ``row`` is of its normal, of which the force is a turn."""
    if spins is None:
        return
    nx, ny = load(spins, row, lanes), load(spins, row + 1, lanes)
    x, y = force * (along * nx - tilt * ny), force * (along * ny + tilt * nx)
    sine, less = turned[0], turned[1]
    n, width = np.uintp(tables.n_lobes + 1 + tables.n_sleeves), count(lanes)
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
def _rub(spins, first, n_here, sleeve, cam, speeds, tables, lanes):
    """Moments of the friction of one kind of sleeves: on the wheel about the cam, of the cam, on the carrier.

    ``sleeve`` is the radius, negative where wheels lie outside, that sign, and the speed of the axles'
    carrier; ``cam`` is in the carrier's axes, ``speeds`` are those of wheel and input.
    """
    t, n = tables.lanes, np.uintp(tables.n_lobes + 1 + tables.n_sleeves)
    radius, side, carrier = sleeve
    rate, omega = speeds
    on_wheel, on_cam, on_carrier = filled(0.0, t, lanes), filled(0.0, t, lanes), filled(0.0, t, lanes)
    zero = filled(0.0, t, lanes)
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
def rub(spins, w, since, cam, speeds, tables, lanes):
    """Moments of all sleeves' friction on one wheel: on it about the cam, of the cam, and on the output.

    ``since`` is the input's turn since the description, ``cam`` in the output's axes.
    """
    t = tables.lanes
    zero = filled(0.0, t, lanes)
    if spins is None:
        return zero, zero, zero
    rate, rate_out, omega = speeds
    n_pins = tables.n_lobes + 1
    fixed = turn_back((load(t, rows.FIXED_CAM_X + w, lanes), load(t, rows.FIXED_CAM_Y + w, lanes)), -since)
    outside = (-load(t, rows.PIN_RADIUS, lanes), -1.0, zero)
    inside = (load(t, rows.SLEEVE_RADIUS, lanes), 1.0, rate_out)
    on_wheel, on_cam, _ = _rub(spins, 0, n_pins, outside, fixed, (rate, omega), tables, lanes)
    more, of_cam, on_output = _rub(spins, n_pins, tables.n_sleeves, inside, cam, (rate, omega), tables, lanes)
    return on_wheel + more, on_cam + of_cam, on_output


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _spin(spins, first, n_here, sleeve, when, tables, lanes):
    """Advance the spin of one kind of sleeves; return the moment of the axles on the carrier."""
    t, n = tables.lanes, np.uintp(tables.n_lobes + 1 + tables.n_sleeves)
    radius, _, carrier = sleeve
    stages, odd, dt, is_first = when
    zero = filled(0.0, t, lanes)
    steep = radius * load(t, rows.INVERSE_TRANSITION, lanes)
    journal = load(t, rows.JOURNAL, lanes) * radius
    by_inertia = load(t, rows.BY_SLEEVE_INERTIA, lanes)
    total = filled(0.0, t, lanes)
    for k in range(np.uintp(first), np.uintp(first + n_here)):
        x, y = load(spins, rows.LOAD_X * n + k, lanes), load(spins, rows.LOAD_Y * n + k, lanes)
        drag = journal * root(x * x + y * y) * tangent(steep * (load(spins, n + k, lanes) - carrier))
        rate = (load(spins, rows.TORQUE * n + k, lanes) - drag) * by_inertia
        if stages == 2:
            midpoint(k, n, odd, dt, rate, spins, lanes)
        else:
            adams_bashforth(k, n, dt, is_first, rate, zero, spins, lanes)
        total = total + drag
        store(spins, rows.LOAD_X * n + k, zero)
        store(spins, rows.LOAD_Y * n + k, zero)
        store(spins, rows.TORQUE * n + k, zero)
    return total


@inner_njit(fastmath=FASTMATH, forceinline=True)
def spin(spins, rate_out, omega, when, tables, lanes):
    """Advance the spins of all sleeves; moments of axles and bearings on the output, and on the input."""
    t = tables.lanes
    zero = filled(0.0, t, lanes)
    if spins is None:
        return zero, zero
    n_pins = tables.n_lobes + 1
    outside = (-load(t, rows.PIN_RADIUS, lanes), -1.0, zero)
    inside = (load(t, rows.SLEEVE_RADIUS, lanes), 1.0, rate_out)
    _spin(spins, 0, n_pins, outside, when, tables, lanes)
    on_output = _spin(spins, n_pins, tables.n_sleeves, inside, when, tables, lanes)
    steep = load(t, rows.INVERSE_BEARING, lanes)
    on_output = on_output - bearing_friction(
        rate_out, load(t, rows.OUTPUT_COULOMB, lanes), load(t, rows.OUTPUT_VISCOUS, lanes), steep
    )
    return on_output, -bearing_friction(
        omega, load(t, rows.INPUT_COULOMB, lanes), load(t, rows.INPUT_VISCOUS, lanes), steep
    )
