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

HEALTHY = 0
WORN = 1
REMOVED = 2

# Reassociation lets the sums over the pins use vector instructions. Infinities and NaN keep their meaning:
# divergence is found by looking for them.
FASTMATH = {"reassoc", "contract", "arcp", "nsz"}

ContactConstants = namedtuple(
    "ContactConstants",
    [
        "law",  # one of the *_LAW constants
        "stiffness_factor",  # K / sqrt(effective radius), N/m^2
        "damping",  # C, Ns/m (Hunt-Crossley: relative damping, s/m)
        "ramp",  # penetration over which K and C rise, m
        "constant_radius",  # effective radius of the conservative law, m
    ],
)

WheelConstants = namedtuple(
    "WheelConstants",
    [
        "eccentricity",
        "shortening",
        "n_lobes",
        "pin_radius",
        "pin_circle_radius",
        "cos_pin",  # (n_pins,) direction of each pin
        "sin_pin",
        "radial_error",  # (n_pins,) position errors of the pins, m
        "tangential_error",
        "runout_x",  # (2,) offset of each wheel's profile from its bearing, in the wheel's frame, m
        "runout_y",
        "rest_angle",  # (2,) theta + phi/z_s in the rest position
        "faulty",  # (2,) whether a wheel has a worn or removed lobe at all
        "lobe_state",  # (2, n_lobes) HEALTHY, WORN or REMOVED
        "lobe_depth",  # (2, n_lobes) share of the lobe's width that is worn, 0 to 1
        "tip",  # tip of lobe 0 (complex), m
        "pit",  # pit of lobe 0 (complex), m
        "pit_normal",  # profile normal there (complex)
        "tip_radius",  # effective contact radius at the tip, m
        "pit_radius",  # and at the pit, m
    ],
)

JointConstants = namedtuple(
    "JointConstants",
    [
        "cos_sleeve",  # (n_internal,) direction of each internal sleeve
        "sin_sleeve",
        "pitch_radius",
        "gap_at_centre",  # hole radius minus sleeve radius, m
        "effective_radius",
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
        - y / 6.0 * (1.0 - y / 20.0 * (1.0 - y / 42.0 * (1.0 - y / 72.0 * (1.0 - y / 110.0 * (1.0 - y / 156.0)))))
    )
    cosine = 1.0 - y / 2.0 * (
        1.0
        - y / 12.0 * (1.0 - y / 30.0 * (1.0 - y / 56.0 * (1.0 - y / 90.0 * (1.0 - y / 132.0 * (1.0 - y / 182.0)))))
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
    rise = min(depth / contact.ramp, 1.0)
    elastic = contact.stiffness_factor * np.sqrt(radius) * rise * depth * np.sqrt(depth)
    if contact.law == HUNT_CROSSLEY_LAW:
        return max(elastic * (1.0 + contact.damping * rate), 0.0)
    return max(elastic + contact.damping * rise * rate, 0.0)


@njit(fastmath=FASTMATH, inline="always")
def _profile_contacts(
    wheel, contact, weight, cx, cy, cvx, cvy, offset_x, offset_y, lobe_cos, lobe_sin, rate, force
):
    """Contacts of all pins with the healthy profile of one wheel: a branch-free loop over the pins.

    Every pin is treated in its own frame (radial, tangential). ``c`` is the cam's centre and ``cv`` its
    velocity, ``offset`` the vector from the foot at rest to the pin's centre, which is the same for all
    pins, ``lobe`` = exp(-i z_s theta). Returns the force on the wheel and its moment about the cam.
    """
    eccentricity = wheel.eccentricity
    inverse_m = 1.0 / wheel.shortening
    n_lobes = float(wheel.n_lobes)
    n_pins = n_lobes + 1.0
    q = wheel.pin_radius
    big_r = wheel.pin_circle_radius
    inverse_ez = 1.0 / (eccentricity * n_pins)
    cos_pin = wheel.cos_pin
    sin_pin = wheel.sin_pin
    radial_error = wheel.radial_error
    tangential_error = wheel.tangential_error
    total_x = 0.0
    total_y = 0.0
    moment = 0.0
    for j in range(cos_pin.size):
        cb = cos_pin[j]
        sb = sin_pin[j]
        dx = cb * offset_x + sb * offset_y + radial_error[j]
        dy = cb * offset_y - sb * offset_x + tangential_error[j]
        # First guess: the foot of the rest position, where exp(i z_s t) = exp(-i beta) exp(-i z_s theta).
        qx = cb * lobe_cos + sb * lobe_sin
        qy = cb * lobe_sin - sb * lobe_cos
        gx = inverse_m + qx
        gg = gx * gx + qy * qy
        ig = 1.0 / np.sqrt(gg)
        nx = gx * ig
        ny = qy * ig
        normal_part = dx * nx + dy * ny
        tangential_part = dy * nx - dx * ny
        kappa = (1.0 + n_lobes * (1.0 + qx * inverse_m) * ig * ig) * ig * inverse_ez
        step = tangential_part * ig * inverse_ez / max(1.0 + kappa * normal_part, 0.3)
        step = min(max(step, -0.06), 0.06)
        # One Newton step, by small-angle polynomials of exp(i step) and exp(i z_k step).
        y = step * step
        s1 = step * (1.0 - y / 6.0 * (1.0 - y / 20.0))
        v1 = y / 2.0 * (1.0 - y / 12.0 * (1.0 - y / 30.0))  # 1 - cos
        x = n_pins * step
        y = x * x
        s2 = x * (1.0 - y / 6.0 * (1.0 - y / 20.0 * (1.0 - y / 42.0 * (1.0 - y / 72.0 * (1.0 - y / 110.0)))))
        v2 = (
            y
            / 2.0
            * (1.0 - y / 12.0 * (1.0 - y / 30.0 * (1.0 - y / 56.0 * (1.0 - y / 90.0 * (1.0 - y / 132.0)))))
        )
        # Vector from the new foot to the pin's centre.
        rx = dx + big_r * v1 + eccentricity * (qx * v2 + qy * s2)
        ry = dy - big_r * s1 + eccentricity * (qy * v2 - qx * s2)
        # exp(i step) g(t) = exp(i step)/m + exp(i z_k step) exp(i z_s t0)
        c1 = 1.0 - v1
        c2 = 1.0 - v2
        hx = c1 * inverse_m + c2 * qx - s2 * qy
        hy = s1 * inverse_m + c2 * qy + s2 * qx
        gg = hx * hx + hy * hy
        ig = 1.0 / np.sqrt(gg)
        nx = hx * ig
        ny = hy * ig
        # |g|^2 = 1/m^2 + 1 + 2 cos(z_s t)/m gives cos(z_s t) without another rotation.
        cos_lobe = (gg - inverse_m * inverse_m - 1.0) / (2.0 * inverse_m)
        kappa = (1.0 + n_lobes * (1.0 + cos_lobe * inverse_m) * ig * ig) * ig * inverse_ez
        normal_part = rx * nx + ry * ny
        tangential_part = ry * nx - rx * ny
        # What is left of the tangential part is taken on the osculating circle.
        bend = kappa * tangential_part / max(1.0 + kappa * normal_part, 0.3)
        gap = normal_part + 0.5 * bend * tangential_part
        shrink = 1.0 - 0.5 * bend * bend
        mx = shrink * nx - bend * ny
        my = shrink * ny + bend * nx
        px = big_r + radial_error[j] - (cb * cx + sb * cy)
        py = tangential_error[j] - (cb * cy - sb * cx)
        arm = px * my - py * mx
        gap_rate = -(mx * (cb * cvx + sb * cvy) + my * (cb * cvy - sb * cvx)) - rate * arm
        radius = max(q * (1.0 - kappa * q), 0.0)
        f = weight[j] * contact_force(-gap, -gap_rate, radius, contact)
        force[j] = f
        total_x -= f * (cb * mx - sb * my)
        total_y -= f * (sb * mx + cb * my)
        moment -= f * arm
    return total_x, total_y, moment


@njit(fastmath=FASTMATH, inline="always")
def _point_contact(point_x, point_y, px, py, q, vx, vy, rate, radius, share, contact):
    """Contact of a pin (centre p) with a point of the wheel, in a frame turning with the wheel."""
    ax = px - point_x
    ay = py - point_y
    distance = np.sqrt(ax * ax + ay * ay)
    nx = ax / distance
    ny = ay / distance
    gap_rate = nx * vx + ny * vy - rate * (px * ny - py * nx)
    return share * contact_force(q - distance, -gap_rate, radius, contact), nx, ny


@njit(fastmath=FASTMATH)
def _faulty_lobes(wheel, contact, index, theta, cos_theta, sin_theta, cx, cy, cvx, cvy, rate, weight, force):
    """Contacts at worn and removed lobes of one wheel.

    Writes into ``weight`` how much of the healthy profile is left under each pin, adds to ``force`` per pin,
    and returns the force on the wheel and its moment. The outline is one closed curve: a pin rests on the
    tip's vertex before it lies on the chord, and at the re-entrant pit it touches chord and flank at once.
    """
    n_lobes = wheel.n_lobes
    n_pins = n_lobes + 1
    pin_pitch = 2.0 * np.pi / n_pins
    lobe_pitch = 2.0 * np.pi / n_lobes
    q = wheel.pin_radius
    tip = wheel.tip.real
    pit_x = wheel.pit.real
    pit_y = wheel.pit.imag
    pit_nx = wheel.pit_normal.real
    pit_ny = wheel.pit_normal.imag
    chord_x = pit_x - tip
    chord_y = pit_y
    length = np.sqrt(chord_x * chord_x + chord_y * chord_y)
    ux = chord_x / length
    uy = chord_y / length
    # Outward normal of the chord.
    ox = uy
    oy = -ux
    chord_angle = np.arctan2(oy, ox)
    total_x = 0.0
    total_y = 0.0
    moment = 0.0
    for lobe in range(n_lobes):
        state = wheel.lobe_state[index, lobe]
        if state == HEALTHY:
            continue
        share = wheel.lobe_depth[index, lobe]
        turn = lobe * lobe_pitch
        sin_turn = np.sin(turn)
        cos_turn = np.cos(turn)
        cl = cos_theta * cos_turn - sin_theta * sin_turn
        sl = sin_theta * cos_turn + cos_theta * sin_turn
        first = int(np.ceil((theta + turn) / pin_pitch - 0.06))
        n_candidates = 1 if state == WORN else 2
        for candidate in range(n_candidates):
            raw = first + candidate
            j = raw % n_pins
            # Pin's centre and velocity of the cam in the frame of the lobe.
            wx = wheel.pin_circle_radius + wheel.radial_error[j]
            wy = wheel.tangential_error[j]
            gx = wheel.cos_pin[j] * wx - wheel.sin_pin[j] * wy - cx
            gy = wheel.sin_pin[j] * wx + wheel.cos_pin[j] * wy - cy
            px = cl * gx + sl * gy
            py = cl * gy - sl * gx
            # The runout moves the profile against the bearing: lever arms count from the bearing.
            hx = cos_turn * wheel.runout_x[index] + sin_turn * wheel.runout_y[index]
            hy = cos_turn * wheel.runout_y[index] - sin_turn * wheel.runout_x[index]
            vx = -(cl * cvx + sl * cvy)
            vy = -(cl * cvy - sl * cvx)
            after_tip = py - hy  # (p - tip) . tangent at the tip
            if after_tip < 0.0:
                continue
            fx = 0.0
            fy = 0.0
            total = 0.0
            if state == WORN:
                ahead = raw * pin_pitch - (theta + turn)
                if ahead > 0.8 * lobe_pitch:
                    continue
                # (p - pit) . tangent at the pit
                after_pit = -(px - hx - pit_x) * pit_ny + (py - hy - pit_y) * pit_nx
                along = (px - hx - tip) * ux + (py - hy) * uy
                if along < 0.0:
                    angle = np.arctan2(py - hy, px - hx - tip)
                    part = min(max(angle / chord_angle, 0.0), 1.0)
                    radius = wheel.tip_radius + part * (q - wheel.tip_radius)
                    f, nx, ny = _point_contact(
                        tip + hx, hy, px, py, q, vx, vy, rate, radius, share, contact
                    )
                else:
                    nx = ox
                    ny = oy
                    gap = (px - hx - tip) * nx + (py - hy) * ny - q
                    gap_rate = nx * vx + ny * vy - rate * (px * ny - py * nx)
                    f = share * contact_force(-gap, -gap_rate, q, contact)
                fx -= f * nx
                fy -= f * ny
                total += f
                if after_pit < 0.0:
                    weight[j] = 1.0 - share
                    f, nx, ny = _point_contact(
                        pit_x + hx, pit_y + hy, px, py, q, vx, vy, rate, wheel.pit_radius, share, contact
                    )
                    fx -= f * nx
                    fy -= f * ny
                    total += f
            else:
                end_x = tip * np.cos(lobe_pitch)
                end_y = tip * np.sin(lobe_pitch)
                before_end = (px - hx - end_x) * np.sin(lobe_pitch) - (py - hy - end_y) * np.cos(lobe_pitch)
                if before_end < 0.0:
                    continue
                weight[j] = 0.0
                if wheel.lobe_state[index, (lobe - 1) % n_lobes] != REMOVED:
                    f, nx, ny = _point_contact(
                        tip + hx, hy, px, py, q, vx, vy, rate, wheel.tip_radius, 1.0, contact
                    )
                    fx -= f * nx
                    fy -= f * ny
                    total += f
                if wheel.lobe_state[index, (lobe + 1) % n_lobes] != REMOVED:
                    f, nx, ny = _point_contact(
                        end_x + hx, end_y + hy, px, py, q, vx, vy, rate, wheel.tip_radius, 1.0, contact
                    )
                    fx -= f * nx
                    fy -= f * ny
                    total += f
            force[j] += total
            total_x += cl * fx - sl * fy
            total_y += sl * fx + cl * fy
            moment += px * fy - py * fx
    return total_x, total_y, moment


@njit(fastmath=FASTMATH, inline="always")
def _joint_contacts(
    joint, contact, cx, cy, cvx, cvy, cos_out, sin_out, cos_wheel, sin_wheel, rate_out, rate_wheel, force
):
    """Contacts of all internal sleeves with the holes of one wheel.

    Returns force and moment on the wheel and the moment on the output shaft about the origin.
    """
    r = joint.pitch_radius
    shift_x = r * (cos_out - cos_wheel)
    shift_y = r * (sin_out - sin_wheel)
    cos_sleeve = joint.cos_sleeve
    sin_sleeve = joint.sin_sleeve
    total_x = 0.0
    total_y = 0.0
    moment = 0.0
    moment_out = 0.0
    for k in range(cos_sleeve.size):
        ca = cos_sleeve[k]
        sa = sin_sleeve[k]
        dx = ca * shift_x - sa * shift_y - cx
        dy = sa * shift_x + ca * shift_y - cy
        distance = np.sqrt(dx * dx + dy * dy)
        nx = dx / distance
        ny = dy / distance
        hole_x = r * (ca * cos_wheel - sa * sin_wheel)
        hole_y = r * (sa * cos_wheel + ca * sin_wheel)
        sleeve_x = r * (ca * cos_out - sa * sin_out)
        sleeve_y = r * (sa * cos_out + ca * sin_out)
        arm_wheel = hole_x * ny - hole_y * nx
        arm_out = sleeve_x * ny - sleeve_y * nx
        penetration_rate = rate_out * arm_out - rate_wheel * arm_wheel - (cvx * nx + cvy * ny)
        f = contact_force(distance - joint.gap_at_centre, penetration_rate, joint.effective_radius, contact)
        force[k] = f
        total_x += f * nx
        total_y += f * ny
        moment += f * arm_wheel
        moment_out -= f * arm_out
    return total_x, total_y, moment, moment_out


@njit(fastmath=FASTMATH)
def derivatives(
    phi, cos_phi, sin_phi, cos_slow, sin_slow, omega, alpha, load, state, wheel, joint, contact, joint_contact,
    body, weight, pin_force, sleeve_force, rates, result,
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
        # exp(i theta') of the holes, theta' = eps - phi/z_s
        cos_hole = cos_slow * eps_cos - sin_slow * eps_sin
        sin_hole = sin_slow * eps_cos + cos_slow * eps_sin
        # exp(-i z_s theta) = -exp(i phi_w) exp(-i z_s eps), phi_w the angle of the wheel's own cam
        lobe_eps_sin, lobe_eps_cos = small_sincos(z * state[w])
        lobe_cos = -side * (cos_phi * lobe_eps_cos + sin_phi * lobe_eps_sin)
        lobe_sin = -side * (sin_phi * lobe_eps_cos - cos_phi * lobe_eps_sin)
        cos_rest = np.cos(wheel.rest_angle[w])
        sin_rest = np.sin(wheel.rest_angle[w])
        cos_theta = cos_hole * cos_rest - sin_hole * sin_rest
        sin_theta = sin_hole * cos_rest + cos_hole * sin_rest
        run_x = cos_theta * wheel.runout_x[w] - sin_theta * wheel.runout_y[w]
        run_y = sin_theta * wheel.runout_x[w] + cos_theta * wheel.runout_y[w]
        offset_x = -(cx + e * lobe_cos) - run_x
        offset_y = -(cy + e * lobe_sin) - run_y
        for j in range(wheel.cos_pin.size):
            weight[j] = 1.0
        fault_x = 0.0
        fault_y = 0.0
        fault_moment = 0.0
        fault_force = pin_force[2 + w]
        if wheel.faulty[w]:
            for j in range(wheel.cos_pin.size):
                fault_force[j] = 0.0
            theta = state[w] - phi / z + wheel.rest_angle[w]
            fault_x, fault_y, fault_moment = _faulty_lobes(
                wheel, contact, w, theta, cos_theta, sin_theta, cx, cy, cvx, cvy, rate, weight, fault_force
            )
        fx, fy, moment = _profile_contacts(
            wheel, contact, weight, cx, cy, cvx, cvy, offset_x, offset_y, lobe_cos, lobe_sin, rate, pin_force[w]
        )
        if wheel.faulty[w]:
            for j in range(wheel.cos_pin.size):
                pin_force[w, j] += fault_force[j]
        jx, jy, joint_moment, on_output = _joint_contacts(
            joint, joint_contact, cx, cy, cvx, cvy, cos_out, sin_out, cos_hole, sin_hole, rate_out, rate,
            sleeve_force[w],
        )  # fmt: skip
        moment_out += on_output
        rates[w] = state[4 + w]
        rates[4 + w] = (moment + fault_moment + joint_moment) / body.wheel_inertia - mean_acceleration
        # Cam's force on the wheel, and its moment about the input shaft.
        reaction_x = body.wheel_mass * (-alpha * cy - omega * omega * cx) - (fx + fault_x + jx)
        reaction_y = body.wheel_mass * (alpha * cx - omega * omega * cy) - (fy + fault_y + jy)
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


@njit(fastmath=FASTMATH)
def integrate(
    first_step, n_steps, dt, phi, omega, alpha, load, state, wheel, joint, contact, joint_contact, body,
    limit, result, angles, pin_forces, sleeve_forces,
):  # fmt: skip
    """Midpoint rule (second-order Runge-Kutta) over ``n_steps`` steps.

    ``phi``, ``omega``, ``alpha``, ``load`` hold the driver and load at every half step: (2 n_steps + 1,).
    ``result`` is (n, 2), ``angles`` (n or 0, 4), ``pin_forces`` (n or 0, 2, n_pins), ``sleeve_forces``
    (n or 0, 2, n_internal): written at every step where they have rows. Returns the number of finished
    steps: fewer than ``n_steps`` where a rate stopped being finite or a torque exceeded ``limit``.
    """
    n_pins = wheel.cos_pin.size
    z = float(wheel.n_lobes)
    weight = np.ones(n_pins)
    pin_force = np.zeros((4, n_pins))
    sleeve_force = np.zeros((2, joint.cos_sleeve.size))
    rates = np.zeros(N_STATE)
    middle = np.zeros(N_STATE)
    now = np.zeros(N_RESULT)
    scratch = np.zeros(N_RESULT)
    for step in range(n_steps):
        i = 2 * step
        cos_phi = np.cos(phi[i])
        sin_phi = np.sin(phi[i])
        cos_slow = np.cos(phi[i] / z)
        sin_slow = -np.sin(phi[i] / z)
        derivatives(
            phi[i], cos_phi, sin_phi, cos_slow, sin_slow, omega[i], alpha[i], load[i], state, wheel, joint,
            contact, joint_contact, body, weight, pin_force, sleeve_force, rates, now,
        )  # fmt: skip
        row = first_step + step
        result[row, 0] = now[0]
        result[row, 1] = now[1]
        if row < angles.shape[0]:
            for k in range(4):
                angles[row, k] = state[k]
        if row < pin_forces.shape[0]:
            pin_forces[row] = pin_force[:2]
        if row < sleeve_forces.shape[0]:
            sleeve_forces[row] = sleeve_force
        if not (abs(now[0]) < limit and abs(now[1]) < limit):
            return step
        for k in range(N_STATE):
            middle[k] = state[k] + 0.5 * dt * rates[k]
        turn = phi[i + 1] - phi[i]
        cos_phi, sin_phi = _turn(cos_phi, sin_phi, turn)
        cos_slow, sin_slow = _turn(cos_slow, sin_slow, -turn / z)
        derivatives(
            phi[i + 1], cos_phi, sin_phi, cos_slow, sin_slow, omega[i + 1], alpha[i + 1], load[i + 1], middle,
            wheel, joint, contact, joint_contact, body, weight, pin_force, sleeve_force, rates, scratch,
        )  # fmt: skip
        for k in range(N_STATE):
            state[k] += dt * rates[k]
    return n_steps
