"""The energy of a run is accounted for: nothing is lost or made but what the papers' law makes."""

from __future__ import annotations

import numpy as np
import pytest
from reference_tools import SPEED, kernels
from scipy.integrate import quad

from cyclofeat.simulators import (
    CycloidalGearbox,
    GearboxLocked,
    LobeDefects,
    PinErrors,
    Rig,
    SimulationDiverged,
    Solver,
    energy_audit,
    simulate,
)
from cyclofeat.simulators.tables import kernel_input

STEEL = CycloidalGearbox.steel()
CONSERVATIVE = STEEL.replace(contact_law="conservative")
RUBBING = CONSERVATIVE.replace(
    sleeve_friction=0.1,
    sleeve_static_friction=0.15,
    sleeve_viscous_friction=5.0,
    journal_friction=0.02,
    input_bearing_torque=0.1,
    output_bearing_torque=0.5,
    output_bearing_viscosity=0.01,
)
WORN = LobeDefects.worn(7)


@pytest.mark.parametrize(
    ("gearbox", "defects"),
    [
        (CONSERVATIVE, LobeDefects.healthy()),
        (CONSERVATIVE, WORN),
        pytest.param(CONSERVATIVE, LobeDefects.worn((0, 4), wheels=(0,), depth=0.4), marks=pytest.mark.slow),
        pytest.param(CONSERVATIVE, LobeDefects.worn(7, wear_um=100), marks=pytest.mark.slow),
        pytest.param(CONSERVATIVE, LobeDefects.removed(7, wheels=(0,)), marks=pytest.mark.slow),
        (CONSERVATIVE.with_brake(0.02, 1e4, 0.05), WORN),
        (RUBBING, WORN),
        pytest.param(Rig(CONSERVATIVE, [PinErrors(1e-5)]).draw(1).gearbox, WORN, marks=pytest.mark.slow),
        pytest.param(
            CONSERVATIVE.replace(pin_clearance=2e-5, cam_errors=(1e-5 + 1e-5j, -2e-5j)),
            WORN,
            marks=pytest.mark.slow,
        ),
    ],
    ids=["healthy", "worn", "partly", "radial", "removed", "brake", "friction", "pins", "clearance"],
)
def test_conservative_law_balances(gearbox: CycloidalGearbox, defects: LobeDefects) -> None:
    """1e-3 was asked for; only the quadrature is left."""
    audit = energy_audit(gearbox, defects, duration=0.12)
    assert abs(audit.relative_leak) < 1e-5
    assert audit.contact_dissipation > 0
    assert (audit.friction > 0) == gearbox.has_friction
    assert (audit.meter_damping > 0) == (gearbox.brake_inertia > 0)
    assert audit.output_work == pytest.approx(22 * SPEED / 15 * 0.12, rel=0.01)


def test_the_audit_finds_what_is_taken_out_of_it() -> None:
    """No term is so small that its loss would pass the tolerance above."""
    audit = energy_audit(RUBBING.with_brake(0.02, 1e4, 0.05), WORN, duration=0.12)
    assert abs(audit.relative_leak) < 1e-5
    for name in ("kinetic_change", "elastic_change", "contact_dissipation", "friction", "meter_damping"):
        assert abs(getattr(audit, name)) > 1e-4 * audit.input_work, name


@pytest.mark.slow
def test_conservative_law_balances_from_the_start() -> None:
    """With a worn lobe pressed in at rest, over the ramp, whose energy goes into motion and heat."""
    audit = energy_audit(CONSERVATIVE, LobeDefects.worn(2), start_time=0.0, duration=0.3)
    assert audit.elastic_change < -0.2
    assert abs(audit.relative_leak) < 1e-4


@pytest.mark.slow
def test_the_papers_law_makes_energy() -> None:
    """Mean input torque 1.454 Nm where 22/15 = 1.4667 Nm balance it; the audit finds the difference."""
    audit = energy_audit()
    assert audit.relative_leak == pytest.approx(-0.0095, abs=3e-4)
    run = simulate(duration=0.54, sampling_rate=1e5, solver=Solver(decimation="pick"))
    mean = run.torque_in[-24_000:].mean()
    assert mean == pytest.approx(1.454, rel=1e-3)
    assert audit.input_work == pytest.approx(mean * SPEED * 0.24, rel=1e-5)
    # What the mean torque lacks to the load's is the leak, but for the little that the damping takes.
    missing = (22 / 15 - mean) / mean
    assert -audit.relative_leak == pytest.approx(
        missing + audit.contact_dissipation / audit.input_work, abs=2e-4
    )
    conservative = simulate(CONSERVATIVE, duration=0.54, sampling_rate=1e5, solver=Solver(decimation="pick"))
    assert conservative.torque_in[-24_000:].mean() == pytest.approx(1.4675, rel=2e-4)


@pytest.mark.slow
def test_the_leak_belongs_to_the_law_and_not_to_the_step() -> None:
    """Half the step leaves the papers' leak as it is and makes the conservative law's quadrature finer."""
    paper = [energy_audit(STEEL, dt=dt, duration=0.12).relative_leak for dt in (1e-5, 5e-6)]
    assert paper[1] == pytest.approx(paper[0], rel=1e-3)
    left = [abs(energy_audit(CONSERVATIVE, WORN, dt=dt, duration=0.12).relative_leak) for dt in (4e-5, 2e-5)]
    assert left[1] < 0.5 * left[0]


@pytest.mark.slow
def test_hunt_crossley_law_takes_energy_and_keeps_the_papers_leak() -> None:
    audit = energy_audit(STEEL.replace(contact_law="hunt_crossley", contact_damping=0.5), WORN)
    assert audit.contact_dissipation > 0
    without = energy_audit(
        STEEL.replace(contact_law="hunt_crossley", contact_damping=0.5, contact_ramp=1e-6), duration=0.12
    )
    assert without.relative_leak == pytest.approx(-0.0095, abs=1e-3)


@pytest.mark.slow
def test_a_period_in_parts_is_as_good_as_one() -> None:
    """The whole period is longer than the steps that are worked on at one time."""
    whole = energy_audit(RUBBING, WORN, duration=0.12, start_time=0.25)
    parts = [energy_audit(RUBBING, WORN, duration=0.06, start_time=start) for start in (0.25, 0.31)]
    for name in ("input_work", "output_work", "friction", "contact_dissipation"):
        assert sum(getattr(part, name) for part in parts) == pytest.approx(getattr(whole, name), rel=1e-6)
    assert (whole.start_time, whole.end_time) == pytest.approx((0.25, 0.37))


@pytest.mark.parametrize("law", ["paper", "conservative", "hunt_crossley"])
@pytest.mark.parametrize("depth", [-1e-6, 3e-6, 1e-5, 2e-5, 3e-4])
def test_stored_energy_is_the_integral_of_the_elastic_force(law: str, depth: float) -> None:
    contact = kernel_input(STEEL.replace(contact_law=law), LobeDefects.healthy()).contact
    force, _ = quad(
        lambda d: kernels.contact_force(d, 0.0, 0.02, contact), 0, max(depth, 0), points=[1e-5], epsabs=0
    )
    assert kernels.elastic_energy(depth, 0.02, contact) == pytest.approx(force, rel=1e-9, abs=1e-30)
    assert kernels.elastic_force(depth, 0.02, contact) == kernels.contact_force(depth, 0.0, 0.02, contact)


def test_an_audit_that_meets_a_failure_says_so() -> None:
    wedged = STEEL.replace(sleeve_friction=0.3, journal_friction=0.3)
    with pytest.raises(GearboxLocked, match="locks at t = 0.1"):
        energy_audit(wedged, LobeDefects.removed(7), start_time=0.1, start_angle=-np.pi)
    with pytest.raises(SimulationDiverged, match="smaller dt"):
        energy_audit(STEEL.replace(stiffness_scale=1.0), LobeDefects.worn(1), start_time=0.0)


@pytest.mark.parametrize(
    ("error", "options", "message"),
    [
        (ValueError, {"duration": 0.0}, "duration must be positive and finite, got 0.0"),
        (ValueError, {"dt": float("nan")}, "dt must be positive and finite, got nan"),
        (ValueError, {"start_time": -1.0}, "start_time must be finite and not negative, got -1.0"),
        (TypeError, {"start_time": None}, "start_time must be a number, got None"),
        (TypeError, {"gearbox": 3}, "gearbox must be of type CycloidalGearbox, got 3"),
    ],
)
def test_impossible_arguments_are_refused(error: type[Exception], options: dict, message: str) -> None:
    with pytest.raises(error) as caught:
        energy_audit(**options)
    assert str(caught.value) == message
