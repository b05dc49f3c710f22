"""Time loop of a batch: the reduced model of :mod:`~cyclofeat.simulators._kernels` in every lane."""

from __future__ import annotations

import numpy as np

from cyclofeat.simulators._jit import inner_njit, njit
from cyclofeat.simulators._outline import HOLDS_EPS
from cyclofeat.simulators.batch import _tables as rows
from cyclofeat.simulators.batch._frames import describe_lane, keep_first
from cyclofeat.simulators.batch._lanes import (
    add_exactly,
    advance_state,
    contact_force,
    first_normal,
    flank_arms,
    flank_force,
    flank_gap,
    friction_moments,
    joint_sums,
    pin_way,
    press_pin,
    press_sleeve,
    sleeve_force,
    spin_moments,
    turn_back,
    turned_since,
)
from cyclofeat.simulators.batch._vectors import (
    FASTMATH,
    addresses,
    bits_of,
    choose,
    fill_lanes,
    first_bit,
    lane_count,
    larger,
    largest_lane,
    load,
    magnitude,
    root,
    round_to,
    smaller,
    store,
)

# Of all modules whose functions and constants are compiled here: numba's cache on disk notices changes of
# this file only.
SOURCES_CHECKSUM = 0x2C76B43F


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _load_contact(stiffness, t, lanes):
    return (
        load(t, stiffness, lanes), load(t, rows.DAMPING, lanes), load(t, rows.RELATIVE_DAMPING, lanes),
        load(t, rows.INVERSE_RAMP, lanes),
    )  # fmt: skip


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _load_frame(table, row, lanes):
    return (
        load(table, row, lanes), load(table, row + 1, lanes), load(table, row + 2, lanes),
        load(table, row + 3, lanes),
    )  # fmt: skip


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _flank_moments(flanks, row, n, n_rows, normal, turned, speeds, tables, lanes):
    """Moments of the forces of the flanks from a row on: on the wheel about the cam, and of the cam.

    ``normal`` is the row of the normal of the first.
    """
    rate, _, omega = speeds
    t = tables.lanes
    on_wheel, on_cam = fill_lanes(0.0, t, lanes), fill_lanes(0.0, t, lanes)
    contact = _load_contact(rows.STIFFNESS, t, lanes)
    for _ in range(n):
        frame = _load_frame(flanks, row, lanes)
        v, u, cam_n, cam_t = pin_way(frame, turned)
        gap, slope = flank_gap(
            v, u, load(flanks, row + rows.F_GAP, lanes), load(flanks, row + rows.F_SLOPE, lanes),
            load(flanks, row + rows.F_BEND, lanes), load(flanks, row + rows.F_CHANGE, lanes),
        )  # fmt: skip
        if bits_of(gap < 0.0) != 0:
            radii = (
                load(flanks, row + rows.F_RADIUS, lanes), load(flanks, row + rows.F_RADIUS_SLOPE, lanes),
                load(flanks, row + rows.F_RADIUS_BEND, lanes),
            )  # fmt: skip
            cam_arm, arm = flank_arms(frame, v, u, cam_n, cam_t, slope)
            weight = load(flanks, row + rows.F_WEIGHT, lanes)
            if n_rows == rows.N_LINED_ROWS:
                line = load(flanks, row + rows.F_LINE, lanes) + load(flanks, row + rows.F_LINE_V, lanes) * v
                line = line + load(flanks, row + rows.F_LINE_U, lanes) * u
                weight = choose(line >= 0.0, load(flanks, row + rows.F_BEYOND, lanes), weight)
            force = weight * flank_force(gap, u, radii, rate * arm + omega * cam_arm, contact)
            on_wheel = on_wheel - force * arm
            on_cam = on_cam - force * cam_arm
            along = 1.0 - slope * slope * (1 / 2)
            press_pin(tables.spins, force, along, slope, normal, turned, tables, lanes)
        row += n_rows
        normal += np.uintp(rows.N_NORMAL_ROWS)
    return on_wheel, on_cam


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _edge_moments(edges, row, n, normal, turned, speeds, tables, lanes):
    """Moments of the forces of all edges, as of the flanks."""
    rate, _, omega = speeds
    t = tables.lanes
    on_wheel, on_cam = fill_lanes(0.0, t, lanes), fill_lanes(0.0, t, lanes)
    contact = _load_contact(rows.STIFFNESS, t, lanes)
    pin_radius = load(t, rows.PIN_RADIUS, lanes)
    for _ in range(n):
        frame = _load_frame(edges, row, lanes)
        v, u, cam_n, cam_t = pin_way(frame, turned)
        side = load(edges, row + rows.E_SIDE, lanes)
        is_chord = magnitude(side) < 0.5
        # Height of the pin's centre along n, and its ways along u and beside the edge.
        above, across = load(edges, row + rows.E_OVER, lanes) + v, load(edges, row + rows.E_ALONG, lanes) + u
        aside, height = choose(is_chord, smaller(across, 0.0), across), pin_radius + above
        # Square of the pin's radius less that of its distance.
        inside = -(above * (height + pin_radius) + aside * aside)
        if bits_of(inside > 0.0) != 0:
            distance = root(height * height + aside * aside)
            both = distance + pin_radius
            inverse = 1.0 / (distance * both)  # one quotient for two
            depth = larger(inside * distance * inverse, 0.0)
            along, tilt = height * both * inverse, aside * both * inverse
            cam_arm, arm = cam_n * tilt - cam_t * along, (frame[0] + v) * tilt - (frame[1] + u) * along
            at_pit = magnitude(side + 1.0) < 0.5
            radius = choose(at_pit, load(t, rows.PIT_RADIUS, lanes), load(t, rows.TIP_RADIUS, lanes))
            span = choose(is_chord, load(t, rows.TIP_SPAN, lanes), 0.0)
            turn = smaller(larger(along + load(t, rows.TURN, lanes) * tilt, 0.0), 1.0)
            force = contact_force(depth, rate * arm + omega * cam_arm, radius + turn * span, contact)
            on_chord = load(t, rows.CHORD_NY, lanes) * height + load(t, rows.CHORD_NX, lanes) * across
            beyond = choose(is_chord, on_chord, side * across)
            force = choose(beyond >= 0.0, load(edges, row + rows.E_WEIGHT, lanes), 0.0) * force
            on_wheel = on_wheel - force * arm
            on_cam = on_cam - force * cam_arm
            press_pin(tables.spins, force, along, tilt, normal, turned, tables, lanes)
        row += rows.N_EDGE_ROWS
        normal += np.uintp(rows.N_NORMAL_ROWS)
    return on_wheel, on_cam


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _pin_moments(w, faulty, turned, speeds, tables, lanes):
    """Moments of the forces of all pins on one wheel."""
    n_pins, slots = w * (tables.n_lobes + 1), tables.slots
    row, normal = n_pins * rows.N_FLANK_ROWS, first_normal(rows.FLANKS, w, tables)
    n = slots[2 * rows.FLANKS + w]
    on_wheel, on_cam = _flank_moments(
        tables.flanks, row, n, rows.N_FLANK_ROWS, normal, turned, speeds, tables, lanes
    )
    if faulty:
        row, normal = n_pins * rows.N_LINED_ROWS, first_normal(rows.LINED_FLANKS, w, tables)
        n = slots[2 * rows.LINED_FLANKS + w]
        if n > 0:
            more, cam = _flank_moments(
                tables.lined, row, n, rows.N_LINED_ROWS, normal, turned, speeds, tables, lanes
            )
            on_wheel, on_cam = on_wheel + more, on_cam + cam
        n = slots[2 * rows.EDGES + w]
        if n > 0:
            row, normal = rows.N_EDGE_KINDS * n_pins * rows.N_EDGE_ROWS, first_normal(rows.EDGES, w, tables)
            more, cam = _edge_moments(tables.edges, row, n, normal, turned, speeds, tables, lanes)
            on_wheel, on_cam = on_wheel + more, on_cam + cam
    return on_wheel, on_cam


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _sleeve_moments(w, turned, speeds, tables, lanes):
    """Moments of all sleeves' forces: on the wheel about the cam, of the cam, and on the output.

    Returns the cam in the output's axes, too.
    """
    t, n = tables.lanes, tables.n_sleeves
    cam_x, cam_y = load(t, rows.CAM_X + w, lanes), load(t, rows.CAM_Y + w, lanes)
    cam = (turned[3] * cam_x - turned[2] * cam_y, turned[3] * cam_y + turned[2] * cam_x)
    first = (load(t, rows.FIRST_COS + w, lanes), load(t, rows.FIRST_SIN + w, lanes))
    turn = load(t, rows.AT + 2, lanes) - load(t, rows.AT + w, lanes)
    square, hole, way, out, arm, rates = joint_sums(
        turn, cam, first, load(t, rows.PITCH_RADIUS, lanes), speeds
    )
    cam = turn_back(cam, turn)
    square = square + load(t, rows.CAM_LESS_GAP + w, lanes)
    way_c, way_s = 2.0 * way[0], 2.0 * way[1]
    gap = load(t, rows.GAP, lanes)
    contact = _load_contact(rows.JOINT_STIFFNESS, t, lanes)
    zero = fill_lanes(0.0, t, lanes)
    total, total_c, total_s = zero, zero, zero
    for k in range(np.uintp(n)):
        cosine, sine = tables.sleeves[k], tables.sleeves[np.uintp(n) + k]
        beyond = square + (cosine * way_s - sine * way_c)
        if bits_of(beyond > 0.0) != 0:
            force = sleeve_force(beyond, cosine, sine, rates, gap, contact)
            total = total + force
            total_c = total_c + cosine * force
            total_s = total_s + sine * force
            press_sleeve(tables.spins, k, force, turn, cam, tables, lanes)
    moments = (
        arm * total - (hole[0] * total_c + hole[1] * total_s),
        -(way[0] * total_c + way[1] * total_s),
        out[0] * total_c + out[1] * total_s - arm * total,
    )
    return moments, cam


@inner_njit(fastmath=FASTMATH)
def _count_slots(tables, lanes):
    """Note how many contacts of each kind on each wheel the lane has that has most."""
    for slot in range(6):
        most = largest_lane(load(tables.lanes, rows.N_FLANKS + slot, lanes))
        tables.slots[np.uintp(slot)] = np.int64(most)


@inner_njit(fastmath=FASTMATH)
def _end_lane(lane, step, reason, tables, lanes):
    """Note why a lane ended, and take its contacts away: the other lanes need not wait for them."""
    width = lane_count(lanes)
    tables.ended[lane] = step
    tables.ended[width + lane] = reason
    tables.lanes[rows.ALIVE * width + lane] = 0.0
    for w in range(2):
        for kind in range(3):
            keep_first(kind, w, lane, np.uintp(0), tables, lanes)


@inner_njit(fastmath=FASTMATH)
def _describe_lanes(bits, angle, at, step, tables, lanes, half):
    """Describe all lanes of a mask anew; their input angles stand from index ``at`` on."""
    while bits != 0:
        lane = np.uintp(first_bit(bits))
        bits &= bits - np.uint64(1)
        if not describe_lane(lane, angle[at + lane], tables, lanes, half):
            _end_lane(lane, step, rows.FAR_DISPLACED, tables, lanes)
    _count_slots(tables, lanes)


@inner_njit(fastmath=FASTMATH)
def _end_lanes(bits, locked, step, tables, lanes):
    """End all lanes of a mask whose torque left its range, or which are locked."""
    while bits != 0:
        lane = first_bit(bits)
        reason = rows.LOCKED_UP if (locked >> lane) & np.uint64(1) else rows.LEFT_RANGE
        bits &= bits - np.uint64(1)
        _end_lane(np.uintp(lane), step, reason, tables, lanes)
    _count_slots(tables, lanes)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _turned_eps(w, t, lanes):
    return load(t, rows.AT + w, lanes) - load(t, rows.SEEN_EPS + w, lanes)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _all_moments(m, step, when, faulty, angle, drive, tables, lanes, half):
    """Moments on both wheels (into their rows), on the output, and of the cams about the input.

    ``when`` is the number of stages, if this is the second, the step, and if it is the first: sleeves that
    spin are advanced.
    """
    t = tables.lanes
    phi, omega = load(angle, m, lanes), load(drive, rows.N_DRIVE_ROWS * m + rows.OMEGA, lanes)
    since = round_to(phi - load(tables.seen_phi, 0, lanes), t)
    # The lanes whose description no longer holds; for NaN it never does.
    holds = (since < load(t, rows.AHEAD, lanes)) & (since >= load(t, rows.BEHIND, lanes))
    holds = holds & (magnitude(_turned_eps(0, t, lanes)) < HOLDS_EPS)
    holds = holds & (magnitude(_turned_eps(1, t, lanes)) < HOLDS_EPS)
    due = bits_of(~holds & (load(t, rows.ALIVE, lanes) > 0.0))
    if due != 0:
        _describe_lanes(due, angle, np.uintp(m) * lane_count(lanes), step, tables, lanes, half)
        since = round_to(phi - load(tables.seen_phi, 0, lanes), t)
    inverse_z = load(t, rows.INVERSE_Z, lanes)
    mean_rate = omega * inverse_z
    rate_out = load(t, rows.AT + 6, lanes) - mean_rate
    on_output, on_cams = fill_lanes(0.0, t, lanes), fill_lanes(0.0, t, lanes)
    for w in range(tables.n_wheels):
        turned = turned_since(since, _turned_eps(w, t, lanes), inverse_z)
        speeds = (load(t, rows.AT + 4 + w, lanes) - mean_rate, rate_out, omega)
        on_wheel, on_cam = _pin_moments(w, faulty, turned, speeds, tables, lanes)
        (by_joint, cam_by_joint, by_output), cam = _sleeve_moments(w, turned, speeds, tables, lanes)
        rub, cam_rub, output_rub = friction_moments(tables.spins, w, since, cam, speeds, tables, lanes)
        store(t, rows.MOMENT + w, on_wheel + by_joint + rub)
        on_output = on_output + by_output + output_rub
        on_cams = on_cams + (on_cam + cam_by_joint + cam_rub)
    by_axles, on_input = spin_moments(tables.spins, rate_out, omega, when, tables, lanes)
    return on_output + by_axles, on_cams + on_input


@njit(fastmath=FASTMATH, nogil=True)
def integrate_batch(lanes, half, stages, leaps, first, n, dt, limit, faulty, angle_, drive_, tables_, out_):
    """Go on by ``n`` steps from step ``first``, in two ``stages`` (midpoint) or one.

    The rule of one stage is that of Adams and Bashforth or, if it ``leaps``, the leapfrog rule.
    ``angle`` (stages n, lanes) and ``drive`` (stages n, 4, lanes) hold the input and the load at each
    evaluation. The results of each step go to ``out`` (n, N_RESULTS, lanes). Returns the number of steps
    done: fewer than ``n`` once all lanes have ended.
    """
    tables = rows.Tables(*addresses(tables_[: rows.N_TABLES]), *tables_[rows.N_TABLES :])
    angle, drive, out = addresses((angle_, drive_, out_))
    t = tables.lanes
    zero = fill_lanes(0.0, t, lanes)
    for m in range(stages * n):
        odd = stages == 2 and m % 2 == 1
        i = m // stages
        when = (stages, odd, dt, first + i == 0, leaps)
        on_output, on_cams = _all_moments(m, first + i, when, faulty, angle, drive, tables, lanes, half)
        row = rows.N_DRIVE_ROWS * m
        twist = load(t, rows.AT + 3, lanes) - load(t, rows.AT + 2, lanes)
        twist_rate = load(t, rows.AT + 7, lanes) - load(t, rows.AT + 6, lanes)
        meter = load(t, rows.METER_STIFFNESS, lanes) * twist + load(t, rows.METER_DAMPING, lanes) * twist_rate
        by_wheel, by_brake = load(t, rows.BY_WHEEL_INERTIA, lanes), load(t, rows.BY_BRAKE_INERTIA, lanes)
        braked, load_torque = by_brake > 0.0, load(drive, row + rows.LOAD, lanes)
        torque = choose(braked, meter, -on_output)
        # Accelerations without the drive's share.
        rates = (
            load(t, rows.MOMENT, lanes) * by_wheel,
            load(t, rows.MOMENT + 1, lanes) * by_wheel,
            (on_output + choose(braked, meter, load_torque)) * load(t, rows.BY_OUTPUT_INERTIA, lanes),
            (load_torque - meter) * by_brake,
        )
        push = load(drive, row + rows.PUSH, lanes)
        if not odd:
            torque_in = load(drive, row + rows.ALPHA, lanes) * load(t, rows.SPIN_MASS, lanes) - on_cams
            result = rows.N_RESULTS * i
            store(out, result + rows.TORQUE_OUT, torque)
            store(out, result + rows.TORQUE_IN, torque_in)
            store(out, result + rows.OUTPUT, load(t, rows.AT + 2, lanes))
            store(out, result + rows.OUTPUT_RATE, load(t, rows.AT + 6, lanes))
            size_in = magnitude(torque_in)
            locked = choose(
                size_in > load(t, rows.LOCKED_TORQUE, lanes), load(t, rows.LOCKED, lanes) + 1.0, 0.0
            )
            store(t, rows.LOCKED, locked)
            is_locked = locked > load(t, rows.LOCKED_STEPS, lanes)
            fine = (magnitude(torque) < limit) & (size_in < limit) & ~is_locked
            ended = bits_of(~fine & (load(t, rows.ALIVE, lanes) > 0.0))
            if ended != 0:
                _end_lanes(ended, bits_of(is_locked), first + i, tables, lanes)
                if bits_of(load(t, rows.ALIVE, lanes) > 0.0) == 0:
                    return i
        if not leaps:
            for k in range(np.uintp(4)):
                advance_state(k, 8, when, load(t, rows.AT + 4 + k, lanes), zero, t, lanes)
        advance_state(4, 8, when, rates[0], push, t, lanes)
        advance_state(5, 8, when, rates[1], push, t, lanes)
        advance_state(6, 8, when, rates[2], push, t, lanes)
        push_brake = choose(braked, push, 0.0)
        advance_state(7, 8, when, rates[3], push_brake, t, lanes)
        if leaps:
            for k in range(np.uintp(3)):
                add_exactly(k, 8, dt * (load(t, 4 + k, lanes) - 0.5 * push), t, lanes)
            add_exactly(3, 8, dt * (load(t, 7, lanes) - 0.5 * push_brake), t, lanes)
    return n


@njit(fastmath=False, nogil=True)
def fill_drive(courses, sizes, first, n, stages, n_lobes, angle, drive):
    """Write ``n`` evaluations from number ``first`` of a piece on into ``angle`` and ``drive`` of the kernel.

    ``courses`` (lanes, 4, evaluations) hold a piece of each lane's course, with one evaluation more than the
    lane's ``size``. A lane whose course has ended stands still: nothing reads what it does from there on.
    """
    for lane in range(sizes.size):
        course = courses[lane]
        own = max(min(sizes[lane] - first, n), 0)
        for k in range(own, n):
            angle[k, lane] = course[0, sizes[lane]]
            drive[k, :, lane] = 0.0
        for k in range(own):
            i = first + k
            angle[k, lane] = course[0, i]
            drive[k, rows.OMEGA, lane] = course[1, i]
            drive[k, rows.ALPHA, lane] = course[2, i]
            drive[k, rows.LOAD, lane] = course[3, i]
            # Where a ramp ends the acceleration jumps: the rule of one stage takes its part from the speed.
            push = course[2, i] if stages == 2 else course[1, i + 1] - course[1, i]
            drive[k, rows.PUSH, lane] = push / n_lobes


@njit(fastmath=FASTMATH, nogil=True)
def decimate_lanes(lanes, results_, first, row, phases_, down, begin, samples_):
    """Write the low-passed samples of one row of the results into ``samples`` (n_samples, lanes), in float64.

    As ``scipy.signal.resample_poly``, for all lanes at once. ``results`` begin with step ``first`` and hold
    all steps on which ``samples``, from number ``begin`` on, depend; ``phases`` (up, n_taps) holds the
    low-pass by phases, the latest step's weight last.
    """
    results, phases, samples = addresses((results_, phases_, samples_))
    up, n_taps = phases_.shape
    # The phases hold the middle of the low-pass at this place.
    middle = (n_taps * up) // 2
    for k in range(samples_.shape[0]):
        at = (begin + k) * down + middle
        phase, earliest = at % up, at // up - (n_taps - 1) - first
        total = fill_lanes(0.0, samples, lanes)
        for tap in range(n_taps):
            value = round_to(load(results, rows.N_RESULTS * (earliest + tap) + row, lanes), samples)
            total = total + phases[phase * n_taps + tap] * value
        store(samples, k, total)
