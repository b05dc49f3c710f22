"""What every lane computes for one contact: numbers or vectors of numbers, and nothing of where they run.

Everything is counted from the moment at which a contact's frame was described: small differences form before
they are rounded, so that float32 is enough. In the frame, n points out of the wheel and t is n turned by a
quarter turn; ``lever`` is the vector from the cam to the pin, (v, u) the pin's way along (n, t) since then.
"""

from __future__ import annotations

from cyclofeat.simulators._jit import inner_njit
from cyclofeat.simulators.batch._vectors import FASTMATH, choose, larger, root, smaller


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
def moved(frame, turned):
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
def edge_place(v, u, over, along, is_chord, pin_radius):
    """Place of the pin's centre from an edge, and the square of the pin's radius less that of its distance.

    The place is the height along n, and the ways along u and beside the edge.
    """
    above, across = over + v, along + u
    aside = choose(is_chord, smaller(across, 0.0), across)
    height = pin_radius + above
    return (height, across, aside), -(above * (height + pin_radius) + aside * aside)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def edge_force(frame, way, place, inside, edge, wheel, contact):
    """Force of an edge, its lever arms as of a flank, and its direction's parts along n and t.

    ``way`` is of :func:`moved`, ``place`` and ``inside`` of :func:`edge_place`; ``edge`` is the pin's radius,
    by how much the direction turns the effective radius, that radius and its span; ``wheel`` the rate of the
    wheel and the speed of the input.
    """
    v, u, cam_n, cam_t = way
    height, _, aside = place
    pin_radius, turn, radius, span = edge
    distance = root(height * height + aside * aside)
    both = distance + pin_radius
    inverse = 1.0 / (distance * both)  # one quotient for two
    depth = larger(inside * distance * inverse, 0.0)
    normal, tilt = height * both * inverse, aside * both * inverse
    cam_arm = cam_n * tilt - cam_t * normal
    arm = (frame[0] + v) * tilt - (frame[1] + u) * normal
    radius = radius + smaller(larger(normal + turn * tilt, 0.0), 1.0) * span
    force = contact_force(depth, wheel[0] * arm + wheel[1] * cam_arm, radius, contact)
    return force, cam_arm, arm, normal, tilt


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
def _tangent_parts(x):
    """Numbers whose quotient is the hyperbolic tangent, exact to rounding in float32."""
    x = smaller(larger(x, -10.0), 10.0) * (1 / 8)
    y = x * x
    above, below = x * (1.0 + y * (1 / 9 + y * (1 / 945))), 1.0 + y * (4 / 9 + y * (1 / 63))
    above, below = 2.0 * above * below, above * above + below * below
    above, below = 2.0 * above * below, above * above + below * below
    return 2.0 * above * below, above * above + below * below


@inner_njit(fastmath=FASTMATH, forceinline=True)
def tangent(x):
    """Hyperbolic tangent."""
    above, below = _tangent_parts(x)
    return above / below


@inner_njit(fastmath=FASTMATH, forceinline=True)
def sleeve_friction(slip, force, friction):
    """Coulomb, Stribeck and viscous friction of a sleeve that is pressed with a force.

    ``friction`` is the coefficient of Coulomb friction, by how much it is higher at rest, one over the speeds
    of Stribeck and of transition (the latter last), and the viscous coefficient between them.
    """
    coulomb, at_rest, inverse_stribeck, viscous, inverse_transition = friction
    ratio = slip * inverse_stribeck
    above, below = _tangent_parts(0.5 * ratio * ratio)
    coefficient = coulomb + at_rest * (below - above) / (below + above)  # exp(-2x) from tanh(x)
    viscous = choose(force > 0.0, viscous, 0.0)
    return force * coefficient * tangent(slip * inverse_transition) + viscous * slip


@inner_njit(fastmath=FASTMATH, forceinline=True)
def bearing_friction(speed, coulomb, viscous, inverse_transition):
    """Torque that a shaft's bearing opposes to its speed."""
    return coulomb * tangent(speed * inverse_transition) + viscous * speed
