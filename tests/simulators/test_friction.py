"""Friction of sleeves, axles and shafts' bearings: against 28 rubbing bodies, and against what it must do.

Errors are shares of the largest contact force, with the lever arm of the pins where they are torques.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from reference_tools import SPEED, Kernel, State, kernel_state, random_lobes, simulate_with
from rubbing_gearbox import RubbingGearbox

from benchmarks.reference_gearbox import ReferenceGearbox
from cyclofeat.simulators import CycloidalGearbox, LobeDefects, SimulationRun, Solver, simulate
from cyclofeat.simulators.simulation import GearboxLocked, friction_rates

pytestmark = pytest.mark.slow

STEEL = CycloidalGearbox.steel()
HEALTHY = LobeDefects.healthy()
TURN = 12_000  # steps of an input turn at 500 RPM
LOADED = np.array([1.7e-3, 1.7e-3, 4.1e-3])
N_SLEEVES = 24


def rubbing(rng: np.random.Generator) -> CycloidalGearbox:
    """All kinds of friction at once, and displaced pins."""
    coulomb = rng.uniform(0.02, 0.3)
    return STEEL.replace(
        pin_radial_errors=rng.normal(0, 2e-5, 16), pin_tangential_errors=rng.normal(0, 2e-5, 16),
        clearance=1e-5, sleeve_friction=coulomb, sleeve_static_friction=coulomb + rng.uniform(0, 0.2),
        stribeck_speed=rng.uniform(0.02, 0.2), sleeve_viscous_friction=rng.uniform(0, 20),
        journal_friction=rng.uniform(0, 0.05), friction_transition_speed=rng.uniform(0.005, 0.05),
        bearing_transition_speed=rng.uniform(0.05, 5), input_bearing_torque=rng.uniform(0, 0.3),
        input_bearing_viscosity=rng.uniform(0, 1e-3), output_bearing_torque=rng.uniform(0, 2),
        output_bearing_viscosity=rng.uniform(0, 0.1),
    )  # fmt: skip


def random_operation(rng: np.random.Generator) -> tuple[State, np.ndarray]:
    """Near the deflections under 22 Nm, either way round, with sleeves that spin at random."""
    phi, omega = rng.uniform(-50, 50), rng.choice([-1, 1]) * SPEED
    angles = ReferenceGearbox().rest_angles(phi) + LOADED + rng.normal(0, 3e-4, 3)
    rates = -omega / 15 + rng.normal(0, 1, 3)
    state = State(phi, omega, rng.normal(0, 260), angles, rates, rng.normal(0, 22))
    return state, rng.normal(0, 60, N_SLEEVES)


def full_state(oracle: RubbingGearbox, state: State, spins: np.ndarray) -> np.ndarray:
    return np.append(kernel_state(oracle, state), spins)


def accelerations(got: dict[str, Any]) -> np.ndarray:
    """Of wheels, output shaft and sleeves."""
    return np.concatenate([got["theta_acceleration"], [got["psi_acceleration"]], got["spin_acceleration"]])


def at_state(kernel: Kernel, state: np.ndarray, at: State) -> dict[str, Any]:
    return kernel(state, at.phi, at.omega, at.alpha, at.load)


def drawn(rng: np.random.Generator) -> tuple[CycloidalGearbox, LobeDefects, State, np.ndarray]:
    defects = LobeDefects.worn(random_lobes(rng), depth=float(rng.choice([1.0, 0.5])))
    return rubbing(rng), defects, *random_operation(rng)


# Against the rubbing bodies ---------------------------------------------------------------------------------


def test_kernel_agrees_with_rubbing_bodies() -> None:
    rng = np.random.default_rng(20)
    loaded = 0
    for _ in range(100):
        gearbox, defects, state, spins = drawn(rng)
        oracle = RubbingGearbox(gearbox, defects)
        expected = oracle.rubbing_accelerations(*state[:4], np.append(state.rates, spins), state.load)
        got = at_state(Kernel(gearbox, defects), full_state(oracle, state, spins), state)
        force = max(got["external_force"].max(), got["internal_force"].max(), 1.0)
        torque = force * gearbox.pin_circle_radius
        units = {
            "theta_acceleration": torque / gearbox.wheel_inertia,
            "psi_acceleration": torque / gearbox.output_inertia,
            "spin_acceleration": force * gearbox.pin_radius / gearbox.sleeve_inertia,
            "input_torque": torque,
            "output_torque": torque,
        }
        for name, unit in units.items():
            assert np.abs(got[name] - getattr(expected, name)).max() < 1e-9 * unit, name
        assert max(expected.sleeve_power, expected.journal_power, expected.bearing_power) < 0
        loaded += got["external_force"].max() > 20
    assert loaded > 80


# In motion --------------------------------------------------------------------------------------------------


@functools.cache
def run(gearbox: CycloidalGearbox, defects: LobeDefects = HEALTHY, duration: float = 0.5) -> SimulationRun:
    options: dict[str, Any] = {"sampling_rate": 1e5, "decimation": "pick", "forces": True}
    return simulate_with(gearbox, defects, duration=duration, **options)


def mean_of_turns(values: np.ndarray, n_turns: int = 2) -> float:
    return float(values[-n_turns * TURN :].mean())


def test_no_friction_means_no_trace_of_it() -> None:
    """Fields of friction that have no effect leave every bit in its place."""
    idle = STEEL.replace(stribeck_speed=0.3, friction_transition_speed=0.5, sleeve_inertia=1.0)
    assert not idle.has_friction
    plain, other = run(STEEL, LobeDefects.worn(2)), run(idle, LobeDefects.worn(2))
    for name in ("torque_out", "torque_in", "output_angle", "external_forces", "internal_forces"):
        assert np.array_equal(getattr(plain, name), getattr(other, name))


def test_vanishing_friction_is_no_friction() -> None:
    """The sleeves then have spins of their own, and the rest goes on as without."""
    tiny = run(STEEL.replace(sleeve_friction=1e-12))
    np.testing.assert_allclose(tiny.torque_in, run(STEEL).torque_in, rtol=0, atol=1e-7)
    np.testing.assert_allclose(tiny.torque_out, run(STEEL).torque_out, rtol=0, atol=1e-7)


@pytest.mark.parametrize("direction", [1, -1])
def test_bearings_oppose_the_rotation(direction: int) -> None:
    """Input: its torque adds to torque_in. Output: sleeves carry load and bearing, divided by the ratio.

    Behind the output's bearing only the load is left, which is what torque_out shows.
    """
    loads = {"duration": 0.5, "sampling_rate": 1e5, "decimation": "pick", "load": direction * 22.0}

    def turn(gearbox: CycloidalGearbox, **change: Any) -> SimulationRun:
        speed = lambda t: direction * SPEED * np.clip(t / 0.2, 0, 1)  # noqa: E731
        return simulate_with(gearbox, speed=speed, **loads | change)

    plain = turn(STEEL)
    base = mean_of_turns(plain.torque_in)
    assert base * direction > 1
    at_input = turn(STEEL.replace(input_bearing_torque=0.3, input_bearing_viscosity=1e-3))
    rise = mean_of_turns(at_input.torque_in) - base
    assert rise == pytest.approx(direction * (0.3 + 1e-3 * SPEED), rel=1e-4)
    np.testing.assert_allclose(at_input.torque_out, plain.torque_out, rtol=0, atol=1e-8)
    at_output = turn(STEEL.replace(output_bearing_torque=1.5, output_bearing_viscosity=0.1))
    more = 1.5 + 0.1 * SPEED / 15
    heavier = turn(STEEL, load=direction * (22.0 + more))
    assert mean_of_turns(at_output.torque_in) == pytest.approx(mean_of_turns(heavier.torque_in), rel=2e-3)
    assert abs(mean_of_turns(at_output.torque_in)) > abs(base) + 0.9 * more / 15
    assert mean_of_turns(at_output.torque_out) == pytest.approx(direction * 22, abs=5e-3)


def test_brake_sees_no_friction_of_the_output_bearing() -> None:
    """It lies between gearbox and meter, so the meter shows the load."""
    braked = STEEL.with_brake(0.02, 1e4, 0.05).replace(output_bearing_torque=1.5)
    assert mean_of_turns(run(braked, duration=0.8).torque_out, 4) == pytest.approx(22, abs=0.1)


@pytest.mark.parametrize(
    "friction",
    [
        {"sleeve_friction": 0.1},
        {"sleeve_friction": 0.25, "sleeve_static_friction": 0.3, "journal_friction": 0.05},
        {"sleeve_friction": 0.1, "sleeve_viscous_friction": 20.0, "journal_friction": 0.02},
    ],
    ids=["dry", "strong", "viscous"],
)
def test_stable_for_seven_worn_lobes_at_the_default_transition_speed(friction: dict[str, float]) -> None:
    """Half the step gives the same: the friction does not chatter."""
    gearbox = STEEL.replace(**friction)
    options: dict[str, Any] = {"duration": 0.45, "sampling_rate": 1e4, "decimation": "pick", "forces": True}
    coarse, fine = (simulate_with(gearbox, LobeDefects.worn(7), dt=dt, **options) for dt in (1e-5, 5e-6))
    settled = slice(3000, None)
    assert coarse.torque_out[settled].mean() == pytest.approx(22, abs=0.05)
    for name in ("torque_out", "torque_in"):
        difference = getattr(coarse, name)[settled] - getattr(fine, name)[settled]
        assert difference.std() < 0.05 * getattr(fine, name)[settled].std(), name
    assert coarse.external_forces is not None
    assert coarse.external_forces.max() < 720


# Chatter ----------------------------------------------------------------------------------------------------


def test_damping_rates_are_those_of_the_kernel() -> None:
    """At rest, without damping of the contacts: what friction alone does to small speeds of all bodies."""
    rng = np.random.default_rng(24)
    found = []
    for _ in range(10):
        gearbox = rubbing(rng).replace(
            contact_damping=0.0, cam_errors=rng.normal(0, 2e-5, 2) + 1j * rng.normal(0, 2e-5, 2)
        )
        angles = ReferenceGearbox().rest_angles(1.0) + LOADED + rng.normal(0, 3e-4, 3)
        at = State(1.0, 0.0, 0.0, angles, np.zeros(3), 22.0)
        state = full_state(RubbingGearbox(gearbox, HEALTHY), at, np.zeros(N_SLEEVES))
        kernel = Kernel(gearbox, HEALTHY)
        moving = [4, 5, 6, *range(8, state.size)]
        jacobian = np.zeros((len(moving), len(moving)))
        for column, index in enumerate(moving):
            step = 1e-6 * np.eye(state.size)[index]
            ahead, behind = (at_state(kernel, state + side * step, at) for side in (1, -1))
            jacobian[:, column] = (accelerations(ahead) - accelerations(behind)) / 2e-6
        got = kernel(state, 1.0, 0.0, 0.0, 22.0)
        forces = (
            np.concatenate([got[f"{kind}_force"][..., None], got[f"{kind}_vector"]], axis=-1)[None]
            for kind in ("external", "internal")
        )
        rate = friction_rates(gearbox, np.ones(1), np.zeros(1), state[None], *forces)
        assert rate == pytest.approx(-np.linalg.eigvals(jacobian).real.min(), rel=1e-5)
        found.append(float(rate[0]))
    assert max(found) > 5 * min(found)


def chattering(friction: float, dt: float, integrator: str) -> np.ndarray:
    """Torque of seven worn lobes, settled; the friction at which they chatter differs between integrators."""
    gearbox = STEEL.replace(sleeve_friction=friction)
    options: dict[str, Any] = {"duration": 0.45, "sampling_rate": 1e4, "decimation": "pick"}
    found = simulate_with(gearbox, LobeDefects.worn(7), dt=dt, integrator=integrator, **options)
    return found.torque_out[3000:]


@pytest.mark.parametrize(("integrator", "friction"), [("midpoint", 0.5), ("adams_bashforth", 0.3)])
def test_friction_too_steep_for_the_step_chatters_and_is_told(integrator: str, friction: float) -> None:
    """Half the step gives another torque, with a warning; a quarter then gives that of half, without."""
    with pytest.warns(RuntimeWarning, match="friction chatters where surfaces stick") as caught:
        coarse = chattering(friction, 1e-5, integrator)
    told = str(caught[0].message)
    assert len(caught) == 1
    assert f"integrator='{integrator}' with dt = 1e-05 s" in told
    enough = float(told.partition("take a dt below ")[2].partition(" s")[0])
    assert 5e-6 < enough < 1e-5
    half, quarter = (chattering(friction, dt, integrator) for dt in (5e-6, 2.5e-6))
    assert (coarse - half).std() > half.std()
    assert (half - quarter).std() < 0.05 * quarter.std()


def test_a_bearing_that_turns_does_not_chatter() -> None:
    """Its friction is steep at rest only; from the standing start on it would be told."""
    steep = STEEL.replace(output_bearing_torque=8.0)
    with pytest.warns(RuntimeWarning, match="friction chatters"):
        told = simulate(steep, duration=0.02)
    unchecked = simulate(steep, duration=0.02, solver=Solver(check_friction=False))
    np.testing.assert_array_equal(unchecked.torque_out, told.torque_out)
    steady = {"speed": lambda t: 0 * t + STEEL.input_speed, "load": lambda t: 1100 * t}
    simulate_with(steep, duration=0.02, **steady)


# Wedging ----------------------------------------------------------------------------------------------------


def with_removed_lobes(lobes: int | tuple[int, ...], **friction: float) -> SimulationRun:
    # The step is short enough for the blow after a slip: at 1e-5 s friction of 0.3 would chatter in it.
    options: dict[str, Any] = {"dt": 5e-6, "sampling_rate": 1e4, "decimation": "pick", "forces": True}
    gearbox, defects = STEEL.replace(**friction), LobeDefects.removed(lobes)
    return simulate_with(gearbox, defects, duration=0.35, start_angle=-np.pi, **options)


@pytest.mark.parametrize("dt", [1e-5, 2.5e-6])
def test_friction_wedges_a_gearbox_that_lacks_seven_lobes_of_both_wheels(dt: float) -> None:
    """Sleeve 15 stays on the tip of the first lobe that is left instead of sliding down its flank."""
    rubbing = STEEL.replace(sleeve_friction=0.2, journal_friction=0.2)
    with pytest.raises(GearboxLocked) as caught:
        simulate_with(rubbing, LobeDefects.removed(7), duration=0.35, dt=dt, start_angle=-np.pi)
    assert caught.value.time == pytest.approx(0.178, abs=0.005)
    assert caught.value.contact in (
        "the contact of wheel 1 with external sleeve 8 (counted from 1)",
        "the contact of wheel 2 with external sleeve 16 (counted from 1)",
    )
    assert caught.value.force > 7000


def test_it_slips_where_friction_is_low_or_sleeves_spin() -> None:
    """Frictionless as in the papers, at 0.1, and at 0.3 on free axles."""
    for friction in ({}, {"sleeve_friction": 0.1, "journal_friction": 0.1}, {"sleeve_friction": 0.3}):
        run = with_removed_lobes(7, **friction)
        assert run.output_angle is not None
        behind = run.output_angle + run.input_angle / 15
        assert np.rad2deg(behind.max()) > 2


def test_every_second_lobe_removed_runs_with_any_friction() -> None:
    run = with_removed_lobes((1, 3, 5, 7), sleeve_friction=0.3, journal_friction=0.3)
    assert run.external_forces is not None
    assert run.external_forces.max() < 300
    assert run.torque_out[2500:].mean() == pytest.approx(22, abs=0.1)
