"""The reduced model with the output held and the input driven by a torque: numba, floats and arrays only."""

from __future__ import annotations

import numpy as np

from cyclofeat.simulators._jit import addresses, njit
from cyclofeat.simulators._kernels import N_RESULT, derivatives
from cyclofeat.simulators._outline import CAM_X, CAM_Y, COLUMNS, FASTMATH

# Of _kernels.py, which has that of _outline.py: numba's cache on disk notices a change of this file only.
KERNELS_CHECKSUM = 0xD999E973


@njit(fastmath=FASTMATH, forceinline=True)
def _accelerations(
    phi, omega, torque, damping, inertia, through_meter, state, wheel, joint, contact, joint_contact, body,
    friction, pins, mounts, lobes, wear, sleeves, memory, rates, result,
):  # fmt: skip
    """Write the derivative of ``state`` and the torques; return the input's acceleration.

    With alpha = 0 the kernel's input torque is the torque of contacts and bearing on the drive.
    """
    z = float(wheel.n_lobes)
    derivatives(
        phi, np.cos(phi), np.sin(phi), np.cos(phi / z), -np.sin(phi / z), omega, 0.0, 0.0, state, wheel,
        joint, contact, joint_contact, body, friction, pins, mounts, lobes, wear, sleeves, memory, rates,
        result,
    )  # fmt: skip
    alpha = (torque - damping * omega - result[1]) / inertia
    # Deviations are relative to the rest position, which follows the input; the held body is at rest.
    if through_meter:
        rates[7] = 0.0
    else:
        rates[6] = 0.0
    for k in range(4):
        rates[4 + k] += alpha / z
    return alpha


@njit(fastmath=FASTMATH, nogil=True)
def integrate_held(
    n_steps, dt, torque, phi, damping, input_inertia, through_meter, state, wheel, joint, contact,
    joint_contact, body, friction, pins, mounts, lobes, wear, sleeves, memory, limit, every, angle, held,
):  # fmt: skip
    """Midpoint rule over ``n_steps`` steps with the input free.

    ``torque`` (2 n_steps + 1,) is the input torque at half steps; every ``every``-th step records the input
    angle in ``angle`` and the output torque in ``held``. Returns the number of finished steps.
    """
    n_state = state.size
    rates = np.zeros(n_state)
    result = np.zeros(N_RESULT)
    pins, mounts, lobes, wear, sleeves = addresses((pins, mounts, lobes, wear, sleeves))
    memory = addresses(memory)
    inertia = input_inertia
    for w in range(2):
        own = np.uintp(w * COLUMNS)
        inertia += body.wheel_mass * (mounts[own + CAM_X] ** 2 + mounts[own + CAM_Y] ** 2)
    omega = 0.0
    at_phi = phi
    at_omega = omega
    at = state.copy()
    # One call of the accelerations for both halves of a step keeps the code short.
    for m in range(2 * n_steps):
        step = m // 2
        alpha = _accelerations(
            at_phi, at_omega, torque[m], damping, inertia, through_meter, at, wheel, joint, contact,
            joint_contact, body, friction, pins, mounts, lobes, wear, sleeves, memory, rates, result,
        )  # fmt: skip
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
            at_phi = phi
            at_omega = omega
    return n_steps
