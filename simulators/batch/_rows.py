"""Rows and columns of a batch's tables: the numbers of one gearbox stand in one lane."""

from __future__ import annotations

from collections import namedtuple

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

# Why a lane ended.
RUNNING, LEFT_RANGE, LOCKED_UP, FAR_DISPLACED = range(4)
