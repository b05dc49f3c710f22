"""Tables of a batch: rows and columns, and the numbers of each gearbox with its defects in one lane."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.simulators import _kernels, _outline
from cyclofeat.simulators.tables import KernelInput

# Pointers to all tables of a batch, and the numbers that all of its gearboxes share.
Tables = namedtuple(
    "Tables",
    [
        "lanes",  # state and constants: one row of lanes for each row below
        "seen_phi",  # input angle at the description, float64: (lanes,)
        "flanks",  # (2, capacity, N_FLANK_ROWS, lanes)
        "lined",  # flanks that a line may cross: (2, capacity, N_LINED_ROWS, lanes)
        "edges",  # (2, N_EDGE_KINDS capacity, N_EDGE_ROWS, lanes)
        "slots",  # numbers of flanks, lined flanks and edges of each wheel, in the lane that has most: (3, 2)
        "ended",  # step and reason of the end of each lane: (2, lanes)
        "geometry",  # columns below, float64: (lanes, N_COLUMNS)
        "rounded",  # the same in the vectors' numbers
        "pins",  # cosine, sine, share of a pitch, then each lane's radial and tangential errors, in blocks
        "weights",  # weights of lobes by place, for each lane and wheel: (lanes, 2, N_WEIGHTS, n_places)
        "frames",  # working memory: rows of flanks and edges, in blocks of the pins of both wheels
        "bits",  # working memory: masks of the pins, (N_MASKS, blocks)
        "sleeves",  # cosine and sine of each sleeve's angle, float64: (2, n_sleeves)
        "spins",  # rows below for each sleeve where friction spins them, else None: what is compiled differs
        "n_lobes",
        "n_sleeves",
        "n_blocks",  # blocks that hold all pins
        "pitched",  # 1 where lobes have pitch errors, else None: what is compiled differs
        "n_wheels",  # 2, but no constant: the compiler would write the loops over wheels out twice
    ],
)

N_TABLES = len(Tables._fields) - 5

# Place of one wheel at a description: way from the rest position, the cam's centre, direction of the lobes,
# run-out, size of the first, place of pin 0 in pitches, and the cam in the axes of the holes.
Wheel = namedtuple(
    "Wheel",
    [
        "offset_x", "offset_y", "cam_x", "cam_y", "lobe_x", "lobe_y", "run_x", "run_y", "displaced", "place",
        "hole_cam_x", "hole_cam_y",
    ],
)  # fmt: skip

# Rows of the lanes. State (8), the same at this evaluation, rates at the last, and what rounding cut off;
# constants; way of the input from the description to the borders of its cell.
STATE, AT, LAST, CUT_OFF = 0, 8, 16, 24
(
    STIFFNESS, DAMPING, RELATIVE_DAMPING, INVERSE_RAMP, JOINT_STIFFNESS, GAP, INVERSE_Z, PITCH_RADIUS,
    PIN_RADIUS, TURN, CHORD_NX, CHORD_NY, TIP_RADIUS, TIP_SPAN, PIT_RADIUS, BY_WHEEL_INERTIA,
    BY_OUTPUT_INERTIA, BY_BRAKE_INERTIA, METER_STIFFNESS, METER_DAMPING, SPIN_MASS,
    LOCKED_TORQUE, LOCKED_STEPS, ALIVE, LOCKED, AHEAD, BEHIND, SLEEVE_RADIUS, COULOMB, AT_REST,
    INVERSE_STRIBECK, VISCOUS, JOURNAL, INVERSE_TRANSITION, INPUT_COULOMB, INPUT_VISCOUS, OUTPUT_COULOMB,
    OUTPUT_VISCOUS, INVERSE_BEARING, BY_SLEEVE_INERTIA,
) = range(32, 72)  # fmt: skip
# Two rows each, one for a wheel: |cam|^2 - gap^2; at the description the deviation from rest, the cam in the
# axes of the holes and in fixed ones, the direction of the first sleeve, the numbers of contacts; the moment
# on the wheel.
(
    CAM_LESS_GAP, SEEN_EPS, CAM_X, CAM_Y, FIXED_CAM_X, FIXED_CAM_Y, FIRST_COS, FIRST_SIN, N_FLANKS, N_LINED,
    N_EDGES, MOMENT,
) = range(72, 96, 2)  # fmt: skip
N_LANE_ROWS = 96

# Rows of the spins, each as many times as there are sleeves, external and then internal: as the first of the
# lanes; axle in fixed axes (internal: in the output's); force on one wheel, loads of both and torque, which
# are emptied when they are read. Two rows of working memory follow, and for each contact of a pin its normal
# at the description, in fixed axes, and the pin.
AXLE_X, AXLE_Y, FORCE_X, FORCE_Y, LOAD_X, LOAD_Y, TORQUE = range(4, 11)
N_SPIN_ROWS, N_NORMAL_ROWS = 11, 3

# Rows of the drive at each evaluation: speed, acceleration, load, and what the drive adds to all rates.
OMEGA, ALPHA, LOAD, PUSH = range(4)
N_DRIVE_ROWS = 4
# Rows of the results of each step.
TORQUE_OUT, TORQUE_IN, OUTPUT, OUTPUT_RATE = range(4)
N_RESULTS = 4

# Rows of a flank: vector from cam to pin and the cam, along normal and tangent; gap, slope, curvature and
# its change; effective radius and its derivatives; weight. Where a line may cross it: the line and its
# slopes, and the weight on its positive side.
(
    F_LEVER_N, F_LEVER_T, F_CAM_N, F_CAM_T, F_GAP, F_SLOPE, F_BEND, F_CHANGE, F_RADIUS, F_RADIUS_SLOPE,
    F_RADIUS_BEND, F_WEIGHT, F_LINE, F_LINE_V, F_LINE_U, F_BEYOND,
) = range(16)  # fmt: skip
N_FLANK_ROWS, N_LINED_ROWS = 12, 16
FLANKS, LINED_FLANKS, EDGES = range(3)
# Rows of an edge: as above; from the vertex to the pin, along normal (less the pin's radius) and tangent;
# weight; 0 for the chord of a worn lobe, -1 for its pit, 2 or -2 for a tip where a removed lobe lies ahead or
# behind. The sign is the side along t on which a vertex acts.
E_LEVER_N, E_LEVER_T, E_CAM_N, E_CAM_T, E_OVER, E_ALONG, E_WEIGHT, E_SIDE = range(8)
N_EDGE_ROWS = 8
ON_CHORD, AT_PIT, ON_TIP = range(3)
N_EDGE_KINDS = 3
# Rows of the working memory: those of a flank, of each kind of edges, and normals of all in fixed axes.
EDGE_FRAMES, FLANK_NORMALS, EDGE_NORMALS, N_FRAME_ROWS = 16, 40, 42, 48
# Masks; of each kind of edges two.
TOUCHING, OPEN, LINED, ON_EDGE, NEAR_EDGE = 0, 1, 2, 3, 6
N_MASKS = 9

PIN_COS, PIN_SIN, PIN_SHARE = range(3)
# Weights of the half of a lobe from tip to pit, of the half from pit to the next tip, and of its chord; that
# of its tip as a vertex is negative where the lobe behind is removed. The lobe's pitch error in rad
# and its radial wear in m stand beside them.
FIRST_HALF, SECOND_HALF, CHORD, TIP, PITCH_ERROR, RADIAL = range(6)
N_WEIGHTS = 6

# Columns of the geometry; three for each kind of edges (vertex from the tip, normal), two for each wheel.
(
    ECCENTRICITY, INVERSE_M, Z, N_PINS, INVERSE_EZ, CIRCLE_RADIUS, CLEARANCE, RADIUS, CURVE_1, CURVE_3,
    STEEPNESS, STEEPNESS_CHANGE, LARGEST_STEP, PITCH, TIP_LESS, PIT_DOT, CONSTANT_RADIUS, NEAR, CLOSE,
    FLANK_REACH, LINE_REACH, EDGE_REACH, PER_PITCH,
) = range(23)  # fmt: skip
EDGE_X, EDGE_Y, EDGE_NX, EDGE_NY = range(23, 35, 3)
REST_PLACE, REST_COS, REST_SIN, RUNOUT_X, RUNOUT_Y, CAM_0X, CAM_0Y, CAM_LESS, HAS_FAULTS = range(35, 53, 2)
# Middle of the radial wear behind the tip, in pitches, and one over its width; 0 where no lobe has any.
WEAR_MIDDLE, WEAR_BY_WIDTH = 53, 54
N_COLUMNS = 55

# Weights are looked up from two lobes before a pin's own on.
FIRST_PLACE = 2

# Why a lane ended.
RUNNING, LEFT_RANGE, LOCKED_UP, FAR_DISPLACED = range(4)

_ALIGNED = 64  # bytes: a vector then lies in as few lines of the cache as it can
# Shares of the pin circle. Flanks open by more than the first cannot close before the next description: a
# wheel turns by less than HOLDS_EPS on an arm below the pin circle's radius; the rest is for displaced pins.
# No pin slides further than half of the others, to a line across a flank and to an edge.
_FLANK_REACH, _LINE_REACH, _EDGE_REACH = 1.5e-4, 2e-3, 1e-3
# Displacement, as a share of the pin circle, up to which one of Newton's steps comes near enough to the foot.
_CLOSE = 1.5e-3


def aligned_zeros(shape: Sequence[int], dtype: type) -> NDArray[Any]:
    """Return an array of zeros whose memory begins with a line of the cache."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    memory = np.zeros(size + _ALIGNED, dtype=np.uint8)
    first = -memory.ctypes.data % _ALIGNED
    return memory[first : first + size].view(dtype).reshape(shape)


def batch_tables(
    machines: Sequence[KernelInput],
    dt: float,
    limits: tuple[float, float],
    widths: tuple[int, int],
    dtype: type,
) -> Tables:
    """Return the tables of machines with equal numbers of lobes and sleeves, machine in each lane.

    Lanes without a machine are at rest. ``limits`` are the force on a cam in N and the time in s for which it
    locks a machine, ``widths`` the numbers of lanes and of pins of one wheel that are described at once.
    """
    lanes, across = widths
    wheel, joint = machines[0].wheel, machines[0].joint
    n_pins = wheel.n_lobes + 1
    n_blocks = -(-n_pins // across)
    n_places = wheel.n_lobes + 4 + n_blocks * across
    tables = Tables(
        lanes=aligned_zeros((N_LANE_ROWS, lanes), dtype),
        seen_phi=aligned_zeros((lanes,), np.float64),
        flanks=aligned_zeros((2, n_pins, N_FLANK_ROWS, lanes), dtype),
        lined=aligned_zeros((2, n_pins, N_LINED_ROWS, lanes), dtype),
        edges=aligned_zeros((2, N_EDGE_KINDS * n_pins, N_EDGE_ROWS, lanes), dtype),
        slots=np.zeros(6, dtype=np.int64),
        ended=np.zeros((2, lanes), dtype=np.int64),
        geometry=np.zeros((lanes, N_COLUMNS)),
        rounded=np.zeros((lanes, N_COLUMNS), dtype),
        pins=aligned_zeros((3 + 2 * lanes, n_blocks * across), dtype),
        weights=np.ones((lanes, 2, N_WEIGHTS, n_places), dtype),
        frames=aligned_zeros((N_FRAME_ROWS, 2 * n_blocks * across), dtype),
        bits=np.zeros((N_MASKS, n_blocks), dtype=np.uint64),
        sleeves=np.zeros((2, joint.n_sleeves)),
        n_lobes=int(wheel.n_lobes),
        n_sleeves=int(joint.n_sleeves),
        n_blocks=n_blocks,
        pitched=1 if machines[0].wheel.has_pitch_errors else None,
        n_wheels=2,
        spins=None if machines[0].friction is None else _spin_table(machines, lanes, dtype),
    )
    tables.flanks[:, :, F_GAP] = 1.0
    tables.lined[:, :, F_GAP] = 1.0
    tables.pins[: PIN_SIN + 1, :n_pins] = _pin_rows(machines[0])[:2]
    tables.pins[PIN_SHARE, :n_pins] = np.arange(n_pins) / n_pins
    tables.sleeves[:] = _two_rows(machines[0].sleeves)[:, : joint.n_sleeves]
    # A lane without a machine computes nothing that is not a number.
    tables.lanes[[GAP, INVERSE_RAMP, PIN_RADIUS]] = 1.0
    tables.lanes[CAM_LESS_GAP : CAM_LESS_GAP + 2] = -0.5
    for lane, machine in enumerate(machines):
        _fill_lane(tables.lanes[:, lane], machine, dt, limits)
        _fill_geometry(tables.geometry[lane], machine)
        tables.pins[3 + 2 * lane : 5 + 2 * lane, :n_pins] = _pin_rows(machine)[2:]
        wear, radial = machine.wear.reshape(2, 2, _outline.COLUMNS)[:, :, : wheel.n_lobes]
        removed = 1.0 * (wear == _outline.REMOVED)
        worn, tips = wear * (1.0 - removed), removed - np.roll(removed, 1, axis=1)
        errors = _two_rows(machine.lobes[int(_outline.PITCH_ERROR) :])[:, : wheel.n_lobes]
        # In the order of the rows of the weights.
        weights = np.stack([1.0 - removed - worn, 1.0 - removed, worn, tips, errors, radial], axis=1)
        lobes = (np.arange(n_places) - FIRST_PLACE - wheel.n_lobes) % wheel.n_lobes
        tables.weights[lane] = weights[:, :, lobes]
    tables.rounded[:] = tables.geometry
    return tables


def _spin_table(machines: Sequence[KernelInput], lanes: int, dtype: type) -> NDArray[Any]:
    """Return the table of sleeves that spin, at rest."""
    n_pins, joint = machines[0].wheel.n_lobes + 1, machines[0].joint
    n = n_pins + joint.n_sleeves
    # Every pin may touch a flank, one that a line crosses, and each kind of edges, on each of two wheels.
    n_contacts = 2 * (2 + N_EDGE_KINDS) * n_pins
    spins = aligned_zeros((N_SPIN_ROWS * n + 2 + N_NORMAL_ROWS * n_contacts, lanes), dtype)
    axles = spins[AXLE_X * n : (AXLE_Y + 1) * n].reshape(2, n, lanes)
    for lane, machine in enumerate(machines):
        c, s, radial, tangential = _pin_rows(machine)
        radial = machine.wheel.pin_circle_radius + radial
        axles[:, :n_pins, lane] = c * radial - s * tangential, s * radial + c * tangential
        sleeves = _two_rows(machine.sleeves)[:, : joint.n_sleeves]
        axles[:, n_pins:, lane] = machine.joint.pitch_radius * sleeves
    return spins


def _pin_rows(machine: KernelInput) -> NDArray[np.float64]:
    """Return cosine, sine, radial and tangential error of each pin: (4, n_pins)."""
    return machine.pins.reshape(-1, _outline.COLUMNS)[:4, : machine.wheel.n_lobes + 1]


def _two_rows(table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the two rows of one of the exact kernel's tables."""
    return table.reshape(2, _outline.COLUMNS)


def read_states(tables: Tables) -> NDArray[np.float64]:
    """Return the states of all lanes, (lanes, n_state)."""
    parts = [tables.lanes[:8]]
    if tables.spins is not None:
        parts.append(tables.spins[: tables.n_lobes + 1 + tables.n_sleeves])
    return np.concatenate(parts).T.astype(float)


def _fill_lane(lane: NDArray[Any], machine: KernelInput, dt: float, limits: tuple[float, float]) -> None:
    """Fill the constants of one lane."""
    contact, joint, body, wheel = machine.contact, machine.joint, machine.body, machine.wheel
    hunt_crossley = contact.law == _kernels.HUNT_CROSSLEY_LAW
    gap = joint.gap_at_centre
    mounts = _two_rows(machine.mounts)
    cams = np.hypot(mounts[:, _outline.CAM_X], mounts[:, _outline.CAM_Y])
    chord = np.array([wheel.pit_y, wheel.tip_x - wheel.pit_x])
    chord /= np.hypot(*chord)
    constant = wheel.pin_radius if contact.law == _kernels.CONSERVATIVE_LAW else 0.0
    values = {
        STIFFNESS: contact.stiffness_factor,
        DAMPING: 0.0 if hunt_crossley else contact.damping,
        RELATIVE_DAMPING: contact.damping if hunt_crossley else 0.0,
        INVERSE_RAMP: contact.inverse_ramp,
        JOINT_STIFFNESS: contact.stiffness_factor * np.sqrt(machine.joint_contact.constant_radius),
        GAP: gap,
        INVERSE_Z: 1 / wheel.n_lobes,
        PITCH_RADIUS: joint.pitch_radius,
        PIN_RADIUS: wheel.pin_radius,
        TURN: chord[0] / chord[1],
        CHORD_NX: chord[0],
        CHORD_NY: chord[1],
        TIP_RADIUS: constant or wheel.tip_radius,
        TIP_SPAN: 0.0 if constant else wheel.pin_radius - wheel.tip_radius,
        PIT_RADIUS: constant or wheel.pit_radius,
        BY_WHEEL_INERTIA: 1 / body.wheel_inertia,
        BY_OUTPUT_INERTIA: 1 / body.output_inertia,
        BY_BRAKE_INERTIA: 1 / body.brake_inertia if body.brake_inertia > 0 else 0.0,
        METER_STIFFNESS: body.meter_stiffness,
        METER_DAMPING: body.meter_damping,
        SPIN_MASS: body.wheel_mass * float(cams @ cams),
        LOCKED_TORQUE: wheel.eccentricity * limits[0],
        LOCKED_STEPS: limits[1] / dt,
        ALIVE: 1.0,
    }
    friction = machine.friction
    if friction is not None:
        values |= {
            SLEEVE_RADIUS: machine.joint.sleeve_radius,
            COULOMB: friction.sleeve_friction,
            AT_REST: friction.sleeve_static_friction - friction.sleeve_friction,
            INVERSE_STRIBECK: 1 / friction.stribeck_speed,
            VISCOUS: friction.sleeve_viscous_friction,
            JOURNAL: friction.journal_friction,
            INVERSE_TRANSITION: 1 / friction.friction_transition_speed,
            INPUT_COULOMB: friction.input_bearing_torque,
            INPUT_VISCOUS: friction.input_bearing_viscosity,
            OUTPUT_COULOMB: friction.output_bearing_torque,
            OUTPUT_VISCOUS: friction.output_bearing_viscosity,
            INVERSE_BEARING: 1 / friction.bearing_transition_speed,
            BY_SLEEVE_INERTIA: 1 / friction.sleeve_inertia,
        }
    for row, value in values.items():
        lane[row] = value
    lane[CAM_LESS_GAP : CAM_LESS_GAP + 2] = (cams - gap) * (cams + gap)
    # Nothing is described yet: no turn of the input is below this border.
    lane[AHEAD] = -np.inf


def _fill_geometry(columns: NDArray[np.float64], machine: KernelInput) -> None:
    """Fill the geometry of one lane."""
    wheel, mounts = machine.wheel, _two_rows(machine.mounts)
    z, e, inverse_m = float(wheel.n_lobes), wheel.eccentricity, 1 / wheel.shortening
    inverse_ez = 1 / (e * (z + 1))
    length = np.hypot(wheel.pit_x - wheel.tip_x, wheel.pit_y)
    values = {
        ECCENTRICITY: e,
        INVERSE_M: inverse_m,
        Z: z,
        N_PINS: z + 1,
        INVERSE_EZ: inverse_ez,
        CIRCLE_RADIUS: wheel.pin_circle_radius,
        CLEARANCE: wheel.clearance,
        RADIUS: wheel.pin_radius,
        CURVE_1: inverse_ez * (1 + 0.5 * z),
        CURVE_3: inverse_ez * 0.5 * z * (1 - inverse_m**2),
        STEEPNESS: z * inverse_m * inverse_ez,
        STEEPNESS_CHANGE: z * inverse_m * inverse_ez * z * inverse_ez,
        LARGEST_STEP: _outline.LARGEST_STEP * 16 / (z + 1),
        PITCH: 2 * np.pi / z,
        TIP_LESS: wheel.pin_circle_radius - wheel.tip_x,
        PIT_DOT: wheel.pit_y * wheel.pit_nx - wheel.pit_x * wheel.pit_ny,
        EDGE_X: np.array([0.0, wheel.pit_x - wheel.tip_x, 0.0]),
        EDGE_Y: np.array([0.0, wheel.pit_y, 0.0]),
        EDGE_NX: np.array([wheel.pit_y / length, wheel.pit_nx, 1.0]),
        EDGE_NY: np.array([(wheel.tip_x - wheel.pit_x) / length, wheel.pit_ny, 0.0]),
        CONSTANT_RADIUS: wheel.pin_radius if machine.contact.law == _kernels.CONSERVATIVE_LAW else 0.0,
        NEAR: wheel.near,
        CLOSE: 0.0 if wheel.has_pitch_errors else _CLOSE * wheel.pin_circle_radius,
        PER_PITCH: z / (2 * np.pi),
        FLANK_REACH: _FLANK_REACH * wheel.pin_circle_radius,
        LINE_REACH: _LINE_REACH * wheel.pin_circle_radius,
        EDGE_REACH: _EDGE_REACH * wheel.pin_circle_radius,
        REST_PLACE: mounts[:, _outline.REST_ANGLE] * z / (2 * np.pi),
        REST_COS: mounts[:, _outline.REST_COS],
        REST_SIN: mounts[:, _outline.REST_SIN],
        RUNOUT_X: mounts[:, _outline.RUNOUT_X],
        RUNOUT_Y: mounts[:, _outline.RUNOUT_Y],
        CAM_0X: mounts[:, _outline.CAM_X],
        CAM_0Y: mounts[:, _outline.CAM_Y],
        CAM_LESS: mounts[:, _outline.CAM_X] - e * np.array([1, -1]),
        HAS_FAULTS: mounts[:, _outline.HAS_FAULTS],
        WEAR_MIDDLE: wheel.wear_first + 0.5 * wheel.wear_width,
        WEAR_BY_WIDTH: 1 / wheel.wear_width if machine.wear[_outline.RADIAL :].any() else 0.0,
    }
    for column, value in values.items():
        columns[column : column + np.size(value)] = value
