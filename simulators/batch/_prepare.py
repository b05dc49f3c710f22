"""Tables of a batch: the numbers of each gearbox with its defects in one lane."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.simulators import _kernels, _outline
from cyclofeat.simulators.batch import _rows as rows
from cyclofeat.simulators.batch._frames import FIRST_PLACE
from cyclofeat.simulators.tables import KernelInput

_ALIGNED = 64  # bytes: a vector then lies in as few lines of the cache as it can
# Shares of the pin circle. Flanks open by more than the first cannot close before the next description: a
# wheel turns by less than HOLDS_EPS on an arm below the pin circle's radius; the rest is for displaced pins.
# No pin slides further than half of the others, to a line across a flank and to an edge.
_FLANK_REACH, _LINE_REACH, _EDGE_REACH = 1.5e-4, 2e-3, 1e-3
# Displacement, as a share of the pin circle, up to which one of Newton's steps comes near enough to the foot.
_CLOSE = 1.5e-3
_PIN_COLUMNS = (
    _outline.PIN_COS, _outline.PIN_SIN, _outline.PIN_RADIAL_ERROR, _outline.PIN_TANGENTIAL_ERROR,
)  # fmt: skip
_FEWEST_PINS = 10  # with fewer, a lobe is too wide for the short polynomials


def unsuited(one: KernelInput) -> str | None:
    """Return what keeps a gearbox out of a batch, or None."""
    if one.wheel.profile_points > 0:
        return "a polyline as profile"
    if one.wheel.n_lobes + 1 < _FEWEST_PINS:
        return f"fewer than {_FEWEST_PINS} pins"
    return None


def zeros(shape: Sequence[int], dtype: type) -> NDArray[Any]:
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
) -> rows.Tables:
    """Return the tables of machines with equal numbers of lobes and sleeves, one in each lane.

    Lanes without a machine are at rest. ``limits`` are the force on a cam in N and the time in s for which it
    locks a machine, ``widths`` the numbers of lanes and of pins of one wheel that are described at once.
    """
    lanes, across = widths
    wheel, joint = machines[0].wheel, machines[0].joint
    n_pins = wheel.n_lobes + 1
    n_blocks = -(-n_pins // across)
    n_places = wheel.n_lobes + 4 + n_blocks * across
    tables = rows.Tables(
        lanes=zeros((rows.N_LANE_ROWS, lanes), dtype),
        seen_phi=zeros((lanes,), np.float64),
        flanks=zeros((2, n_pins, rows.N_FLANK_ROWS, lanes), dtype),
        lined=zeros((2, n_pins, rows.N_LINED_ROWS, lanes), dtype),
        edges=zeros((2, rows.N_EDGE_KINDS * n_pins, rows.N_EDGE_ROWS, lanes), dtype),
        slots=np.zeros(6, dtype=np.int64),
        ended=np.zeros((2, lanes), dtype=np.int64),
        geometry=np.zeros((lanes, rows.N_COLUMNS)),
        rounded=np.zeros((lanes, rows.N_COLUMNS), dtype),
        pins=zeros((3 + 2 * lanes, n_blocks * across), dtype),
        weights=np.ones((lanes, 2, rows.N_WEIGHTS, n_places), dtype),
        frames=zeros((rows.N_FRAME_ROWS, 2 * n_blocks * across), dtype),
        bits=np.zeros((rows.N_MASKS, n_blocks), dtype=np.uint64),
        sleeves=np.zeros((2, joint.n_sleeves)),
        n_lobes=int(wheel.n_lobes),
        n_sleeves=int(joint.n_sleeves),
        n_blocks=n_blocks,
        pitched=1 if machines[0].wheel.has_pitch_errors else None,
        n_wheels=2,
        spins=None if machines[0].friction is None else _spins(machines, lanes, dtype),
    )
    tables.flanks[:, :, rows.F_GAP] = 1.0
    tables.lined[:, :, rows.F_GAP] = 1.0
    pins = np.arange(n_pins)
    angles = 2 * np.pi * pins / n_pins
    tables.pins[rows.PIN_COS, :n_pins], tables.pins[rows.PIN_SIN, :n_pins] = np.cos(angles), np.sin(angles)
    tables.pins[rows.PIN_SHARE, :n_pins] = pins / n_pins
    sleeves = 2 * np.pi * np.arange(joint.n_sleeves) / joint.n_sleeves
    tables.sleeves[:] = np.cos(sleeves), np.sin(sleeves)
    _empty_lanes(tables)
    for lane, one in enumerate(machines):
        _lane_rows(tables.lanes[:, lane], one, dt, limits)
        _geometry(tables.geometry[lane], one)
        errors = tables.pins[3 + 2 * lane : 5 + 2 * lane, :n_pins]
        for row, first in enumerate((_outline.PIN_RADIAL_ERROR, _outline.PIN_TANGENTIAL_ERROR)):
            errors[row] = one.pins[int(first) : int(first) + n_pins]
        lobes = (np.arange(n_places) - FIRST_PLACE - wheel.n_lobes) % wheel.n_lobes
        tables.weights[lane] = _weights(one)[:, :, lobes]
    tables.rounded[:] = tables.geometry
    return tables


def _weights(one: KernelInput) -> NDArray[np.float64]:
    """Return the weights of all lobes: (2, N_WEIGHTS, n_lobes)."""
    wear, radial = one.wear.reshape(2, 2, _outline.COLUMNS)[:, :, : one.wheel.n_lobes]
    removed = 1.0 * (wear == _outline.REMOVED)
    worn = wear * (1.0 - removed)
    weights = np.empty((2, rows.N_WEIGHTS, wear.shape[1]))
    lobes = _by_wheel(one.lobes[int(_outline.PITCH_ERROR) :])
    weights[:, rows.PITCH_ERROR] = lobes[:, : one.wheel.n_lobes]
    weights[:, rows.FIRST_HALF], weights[:, rows.SECOND_HALF] = 1.0 - removed - worn, 1.0 - removed
    weights[:, rows.RADIAL] = radial
    weights[:, rows.CHORD], weights[:, rows.TIP] = worn, removed - np.roll(removed, 1, axis=1)
    return weights


def _spins(machines: Sequence[KernelInput], lanes: int, dtype: type) -> NDArray[Any]:
    """Return the table of sleeves that spin, at rest."""
    n_pins, joint = machines[0].wheel.n_lobes + 1, machines[0].joint
    n = n_pins + joint.n_sleeves
    # Every pin may touch a flank, one that a line crosses, and each kind of edges, on each of two wheels.
    n_contacts = 2 * (2 + rows.N_EDGE_KINDS) * n_pins
    spins = zeros((rows.N_SPIN_ROWS * n + 2 + rows.N_NORMAL_ROWS * n_contacts, lanes), dtype)
    axles = spins[rows.AXLE_X * n : (rows.AXLE_Y + 1) * n].reshape(2, n, lanes)
    for lane, one in enumerate(machines):
        columns = (int(first) + np.arange(n_pins) for first in _PIN_COLUMNS)
        c, s, radial, tangential = (one.pins[column] for column in columns)
        radial = one.wheel.pin_circle_radius + radial
        axles[:, :n_pins, lane] = c * radial - s * tangential, s * radial + c * tangential
        angles = 2 * np.pi * np.arange(joint.n_sleeves) / joint.n_sleeves
        axles[:, n_pins:, lane] = one.joint.pitch_radius * np.array([np.cos(angles), np.sin(angles)])
    return spins


def _by_wheel(table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows of the exact kernel's tables, one for each wheel."""
    return table.reshape(2, _outline.COLUMNS)


def set_states(tables: rows.Tables, states: Sequence[NDArray[np.float64]]) -> None:
    """Begin the lanes in the given states."""
    for lane, state in enumerate(states):
        _set_states(tables.lanes[:, lane], state[:8])
        if tables.spins is not None:
            _set_states(tables.spins[:, lane], state[8:])


def states(tables: rows.Tables) -> NDArray[np.float64]:
    """Return the states of all lanes, (lanes, n_state)."""
    parts = [tables.lanes[:8]]
    if tables.spins is not None:
        parts.append(tables.spins[: tables.n_lobes + 1 + tables.n_sleeves])
    return np.concatenate(parts).T.astype(float)


def _set_states(column: NDArray[Any], state: NDArray[np.float64]) -> None:
    """Write states where a lane's table begins with them."""
    n = state.size
    column[:n] = column[n : 2 * n] = state
    column[3 * n : 4 * n] = column[:n] - state


def _empty_lanes(tables: rows.Tables) -> None:
    """Numbers with which a lane without a machine computes nothing that is not a number."""
    tables.lanes[[rows.GAP, rows.INVERSE_RAMP, rows.PIN_RADIUS]] = 1.0
    tables.lanes[rows.CAM_LESS_GAP : rows.CAM_LESS_GAP + 2] = -0.5


def _lane_rows(lane: NDArray[Any], one: KernelInput, dt: float, limits: tuple[float, float]) -> None:
    """Fill the constants of one lane."""
    contact, joint, body, wheel = one.contact, one.joint, one.body, one.wheel
    hunt_crossley = contact.law == _kernels.HUNT_CROSSLEY_LAW
    gap = joint.gap_at_centre
    mounts = _by_wheel(one.mounts)
    cams = np.hypot(mounts[:, _outline.CAM_X], mounts[:, _outline.CAM_Y])
    chord = np.array([wheel.pit_y, wheel.tip_x - wheel.pit_x])
    chord /= np.hypot(*chord)
    constant = wheel.pin_radius if contact.law == _kernels.CONSERVATIVE_LAW else 0.0
    values = {
        rows.STIFFNESS: contact.stiffness_factor,
        rows.DAMPING: 0.0 if hunt_crossley else contact.damping,
        rows.RELATIVE_DAMPING: contact.damping if hunt_crossley else 0.0,
        rows.INVERSE_RAMP: contact.inverse_ramp,
        rows.JOINT_STIFFNESS: contact.stiffness_factor * np.sqrt(one.joint_contact.constant_radius),
        rows.GAP: gap,
        rows.INVERSE_Z: 1 / wheel.n_lobes,
        rows.PITCH_RADIUS: joint.pitch_radius,
        rows.PIN_RADIUS: wheel.pin_radius,
        rows.TURN: chord[0] / chord[1],
        rows.CHORD_NX: chord[0],
        rows.CHORD_NY: chord[1],
        rows.TIP_RADIUS: constant or wheel.tip_radius,
        rows.TIP_SPAN: 0.0 if constant else wheel.pin_radius - wheel.tip_radius,
        rows.PIT_RADIUS: constant or wheel.pit_radius,
        rows.BY_WHEEL_INERTIA: 1 / body.wheel_inertia,
        rows.BY_OUTPUT_INERTIA: 1 / body.output_inertia,
        rows.BY_BRAKE_INERTIA: 1 / body.brake_inertia if body.brake_inertia > 0 else 0.0,
        rows.METER_STIFFNESS: body.meter_stiffness,
        rows.METER_DAMPING: body.meter_damping,
        rows.SPIN_MASS: body.wheel_mass * float(cams @ cams),
        rows.LOCKED_TORQUE: wheel.eccentricity * limits[0],
        rows.LOCKED_STEPS: limits[1] / dt,
        rows.ALIVE: 1.0,
    }
    for row, value in (values | _friction(one)).items():
        lane[row] = value
    lane[rows.CAM_LESS_GAP : rows.CAM_LESS_GAP + 2] = (cams - gap) * (cams + gap)
    # Nothing is described yet: no turn of the input is below this border.
    lane[rows.AHEAD] = -np.inf


def _friction(one: KernelInput) -> dict[int, float]:
    """Return the constants of friction by their rows."""
    friction = one.friction
    if friction is None:
        return {}
    return {
        rows.SLEEVE_RADIUS: one.joint.sleeve_radius,
        rows.COULOMB: friction.coulomb,
        rows.AT_REST: friction.static - friction.coulomb,
        rows.INVERSE_STRIBECK: 1 / friction.stribeck_speed,
        rows.VISCOUS: friction.viscous,
        rows.JOURNAL: friction.journal,
        rows.INVERSE_TRANSITION: 1 / friction.transition_speed,
        rows.INPUT_COULOMB: friction.input_coulomb,
        rows.INPUT_VISCOUS: friction.input_viscous,
        rows.OUTPUT_COULOMB: friction.output_coulomb,
        rows.OUTPUT_VISCOUS: friction.output_viscous,
        rows.INVERSE_BEARING: 1 / friction.bearing_transition,
        rows.BY_SLEEVE_INERTIA: 1 / friction.sleeve_inertia,
    }


def _geometry(columns: NDArray[np.float64], one: KernelInput) -> None:
    """Fill the geometry of one lane."""
    wheel, mounts = one.wheel, _by_wheel(one.mounts)
    z, e, inverse_m = float(wheel.n_lobes), wheel.eccentricity, 1 / wheel.shortening
    inverse_ez = 1 / (e * (z + 1))
    length = np.hypot(wheel.pit_x - wheel.tip_x, wheel.pit_y)
    values = {
        rows.ECCENTRICITY: e,
        rows.INVERSE_M: inverse_m,
        rows.Z: z,
        rows.N_PINS: z + 1,
        rows.INVERSE_EZ: inverse_ez,
        rows.CIRCLE_RADIUS: wheel.pin_circle_radius,
        rows.CLEARANCE: wheel.clearance,
        rows.RADIUS: wheel.pin_radius,
        rows.CURVE_1: inverse_ez * (1 + 0.5 * z),
        rows.CURVE_3: inverse_ez * 0.5 * z * (1 - inverse_m**2),
        rows.STEEPNESS: z * inverse_m * inverse_ez,
        rows.STEEPNESS_CHANGE: z * inverse_m * inverse_ez * z * inverse_ez,
        rows.LARGEST_STEP: _outline.LARGEST_STEP * 16 / (z + 1),
        rows.PITCH: 2 * np.pi / z,
        rows.TIP_LESS: wheel.pin_circle_radius - wheel.tip_x,
        rows.PIT_DOT: wheel.pit_y * wheel.pit_nx - wheel.pit_x * wheel.pit_ny,
        rows.EDGE_X: np.array([0.0, wheel.pit_x - wheel.tip_x, 0.0]),
        rows.EDGE_Y: np.array([0.0, wheel.pit_y, 0.0]),
        rows.EDGE_NX: np.array([wheel.pit_y / length, wheel.pit_nx, 1.0]),
        rows.EDGE_NY: np.array([(wheel.tip_x - wheel.pit_x) / length, wheel.pit_ny, 0.0]),
        rows.CONSTANT_RADIUS: wheel.pin_radius if one.contact.law == _kernels.CONSERVATIVE_LAW else 0.0,
        rows.NEAR: wheel.near,
        rows.CLOSE: 0.0 if wheel.has_pitch_errors else _CLOSE * wheel.pin_circle_radius,
        rows.PER_PITCH: z / (2 * np.pi),
        rows.FLANK_REACH: _FLANK_REACH * wheel.pin_circle_radius,
        rows.LINE_REACH: _LINE_REACH * wheel.pin_circle_radius,
        rows.EDGE_REACH: _EDGE_REACH * wheel.pin_circle_radius,
        rows.REST_PLACE: mounts[:, _outline.REST_ANGLE] * z / (2 * np.pi),
        rows.REST_COS: mounts[:, _outline.REST_COS],
        rows.REST_SIN: mounts[:, _outline.REST_SIN],
        rows.RUNOUT_X: mounts[:, _outline.RUNOUT_X],
        rows.RUNOUT_Y: mounts[:, _outline.RUNOUT_Y],
        rows.CAM_0X: mounts[:, _outline.CAM_X],
        rows.CAM_0Y: mounts[:, _outline.CAM_Y],
        rows.CAM_LESS: mounts[:, _outline.CAM_X] - e * np.array([1, -1]),
        rows.HAS_FAULTS: mounts[:, _outline.HAS_FAULTS],
        rows.WEAR_MIDDLE: wheel.wear_first + 0.5 * wheel.wear_width,
        rows.WEAR_BY_WIDTH: 1 / wheel.wear_width if one.wear[_outline.RADIAL :].any() else 0.0,
    }
    for column, value in values.items():
        columns[column : column + np.size(value)] = value
