"""Effects in torque-deflection loops: friction, play and compliance against the simulator and by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cyclofeat.gap import LoopModel, find_loop_gap
from cyclofeat.gap.loops.parts import contact_deflection, elastic_torque, loop_shape, relative_error
from cyclofeat.simulators import CycloidalGearbox, torque_deflection

pytestmark = pytest.mark.slow  # each compiles, or searches
DRIVE = CycloidalGearbox.printed_14_pin()


def triangle(peak: float, n: int = 400) -> np.ndarray:
    return peak * np.interp(np.arange(n) / n, [0, 0.25, 0.75, 1], [0, 1, -1, 0])


def loop_of(theta: dict[str, float], peak: float, noise: float = 0.0, seed: int = 0) -> SimpleNamespace:
    """A loop made with known parameters, and noise of that share of its rms."""
    model = LoopModel(tuple({name.partition(".")[0]: 0 for name in theta}))
    model.plain_ = DRIVE
    torque = triangle(peak)
    x = model._centred_deflection(torque, theta)
    error = np.random.default_rng(seed).normal(size=x.size)
    return SimpleNamespace(torque=torque, deflection=x + noise * x.std() * error)


def test_friction_is_the_play_operator_by_brute_force():
    """Many small steps, each moving only where |T - E| would exceed the friction of the load carried."""
    random = np.random.default_rng(3)
    turning = np.r_[0, random.uniform(-20, 20, 8), 25, -25, 0]
    torque = np.interp(np.linspace(0, len(turning) - 1, 700), np.arange(len(turning)), turning)
    coulomb, share = 2.0, 0.3
    elastic, found = 0.0, np.empty_like(torque)
    for _ in range(2):
        for k, t in enumerate(torque):
            step = 2e-3
            while t - elastic > coulomb + share * abs(elastic):
                elastic += step
            while elastic - t > coulomb + share * abs(elastic):
                elastic -= step
            found[k] = elastic
    assert elastic_torque(torque, coulomb, share) == pytest.approx(found, abs=5e-3)


def test_many_frictions_at_once_are_each_alone():
    torque = triangle(9.0)
    coulomb, share = np.array([0.5, 2.0]), np.array([0.1, 0.6])
    both = elastic_torque(torque, coulomb, share)
    for k in range(2):
        assert both[k] == pytest.approx(elastic_torque(torque, coulomb[k], share[k]))


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_a_factor_on_the_contacts_is_that_factor_in_the_simulation(factor):
    stiffer = DRIVE.replace(
        clearance=5e-5, pin_clearance=5e-5, stiffness_scale=factor * DRIVE.stiffness_scale
    )
    run = torque_deflection(stiffer, peak_torque=30.0, n_cycles=1)
    n = run.torque.size
    at = slice(n // 4 + 5, n // 2 - 30)  # the branch on which the torque falls
    here = contact_deflection(DRIVE, run.held_torque[at], 5e-5, factor)
    assert here == pytest.approx(run.deflection[at], rel=0.02)


def test_a_drive_with_all_three_effects_is_that_in_the_simulation():
    """The series of parts against the integration of the whole drive; friction in the input's bearing."""
    model = LoopModel(max_iter=1, random_state=0).fit(
        [loop_of({"torsional_compliance.stiffness": 300.0}, 10.0)]
    )
    theta = {"clearance.clearance": 5e-5, "friction.coulomb_nm": 1.5, "torsional_compliance.stiffness": 400.0}
    drive = DRIVE.replace(
        clearance=5e-5, pin_clearance=5e-5, meter_stiffness=400.0, input_bearing_torque=1.5 / DRIVE.n_lobes
    )
    run = torque_deflection(drive, peak_torque=20.0, period=2.0)
    torque, deflection = run.last_cycle()
    assert float(relative_error(deflection, model._centred_deflection(torque, theta))) < 0.06
    whole, series = (
        loop_shape(torque, deflection),
        loop_shape(torque, model._centred_deflection(torque, theta)),
    )
    assert series.area == pytest.approx(whole.area, rel=0.1)
    # In the whole drive the wheels turn on while the shaft behind them winds up; the series knows one pose.
    assert series.stiffness == pytest.approx(whole.stiffness, rel=0.08)


def test_known_parameters_come_back_and_predict_another_size_of_loop():
    theta = {
        "friction.coulomb_nm": 2.0, "friction.spread": 0.5, "friction.load_share": 0.3,
        "torsional_compliance.stiffness": 350.0,
    }  # fmt: skip
    model = LoopModel(("friction", "torsional_compliance"), random_state=0).fit(
        [loop_of(theta, 25.0, noise=0.02)]
    )
    assert model.theta_["torsional_compliance.stiffness"] == pytest.approx(350.0, rel=0.05)
    assert model.theta_["friction.coulomb_nm"] == pytest.approx(2.0, rel=0.15)
    assert model.theta_["friction.load_share"] == pytest.approx(0.3, abs=0.05)
    assert -model.score([loop_of(theta, 6.0)]) < 0.1
    assert not any(model.at_bound_.values())


def test_the_right_effects_are_named_and_the_rest_is_left_out():
    made = []
    for seed, (coulomb, stiffness) in enumerate([(1.5, 300.0), (2.0, 400.0), (2.5, 350.0)]):
        theta = {
            "friction.coulomb_nm": coulomb, "friction.spread": 0.5, "friction.load_share": 0.2,
            "torsional_compliance.stiffness": stiffness,
        }  # fmt: skip
        small, large = (loop_of(theta, peak, 0.02, seed) for peak in (5.0, 25.0))
        made += [([small], [large]), ([large], [small])]
    model = LoopModel(max_iter=25, n_points=80, random_state=0)
    gap = find_loop_gap(made, model=model, library=("clearance", "friction", "torsional_compliance"))
    assert gap.effects == ("friction", "torsional_compliance")
    assert all(p <= 0.05 for p in gap.p_without.values())


def test_no_effect_is_named_where_the_model_is_right():
    plain = [loop_of({"clearance.clearance": 0.0}, peak, 0.02, seed) for seed, peak in enumerate((5, 15, 25))]
    transfers = [([a], [b]) for a in plain for b in plain if a is not b]
    model = LoopModel(max_iter=10, n_points=80, random_state=0)
    gap = find_loop_gap(transfers, model=model, library=("clearance", "torsional_compliance"))
    assert gap.effects == ()
    rows = gap.to_frame()
    assert sorted(rows["effects"]) == [
        "",
        "clearance",
        "clearance, torsional_compliance",
        "torsional_compliance",
    ]
    assert rows["error"].is_monotonic_increasing
    assert rows.filter(like="error of transfer").mean(axis=1).to_numpy() == pytest.approx(rows["error"])


def test_too_few_transfers_are_warned_of():
    loop = loop_of({"torsional_compliance.stiffness": 300.0}, 5.0)
    options = {
        "library": ("torsional_compliance",),
        "model": LoopModel(max_iter=1, n_points=20, random_state=0),
    }
    few, enough = (find_loop_gap([([loop], [loop])] * n, **options) for n in (4, 5))
    (warning,) = few.warnings
    assert warning.startswith("4 transfers: no effect can be named, as p over them is never below 0.062")
    assert few.effects == ()
    assert enough.warnings == ()
    assert enough.effects == ("torsional_compliance",)


def test_shape_of_a_parallelogram():
    """Coulomb friction f before a spring k: width 2 f / k, slope k, area of the parallelogram."""
    torque = triangle(10.0, 4000)
    shape = loop_shape(torque, elastic_torque(torque, 2.0, 0.0) / 100)
    assert shape.lost_motion == pytest.approx(2 * 2.0 / 100, rel=0.01)
    assert shape.stiffness == pytest.approx(100, rel=0.01)
    assert shape.area == pytest.approx(2 * 2.0 * 2 * 8.0 / 100, rel=0.01)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: LoopModel(("rust",)).fit([]), "effects must name different effects of clearance"),
        (
            lambda: find_loop_gap([([], [])] * 2, library=("rust",)),
            "library must name different effects of cl",
        ),
        (lambda: find_loop_gap([([], [])] * 2, library=()), "library must name different .*, got none"),
        (lambda: LoopModel().fit([]), "at least one loop"),
        (lambda: LoopModel().fit([SimpleNamespace(torque=[1.0] * 9, deflection=[0.0] * 9)]), "through zero"),
        (lambda: find_loop_gap([]), "2 to 20 pairs"),
        (lambda: contact_deflection(DRIVE, [500.0], 0.0), "must not exceed 115 Nm"),
        (lambda: contact_deflection(DRIVE, [1.0], 1.0), "clearance must lie between"),
        (lambda: loop_shape([0.0, np.nan] * 5, [0.0] * 10), "finite"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_torque_beyond_the_contacts_curve_is_taken_as_far_as_a_factor_reaches():
    wave = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    loop = SimpleNamespace(torque=60 * np.sin(wave), deflection=1e-3 * np.sin(wave - 0.1))
    found = LoopModel(("contact_stiffness_scale",), n_points=40, max_iter=2, random_state=0).fit([loop])
    assert found.theta_["contact_stiffness_scale.factor"] >= 60 / 115
    loop.torque = 2 * loop.torque
    with pytest.raises(ValueError, match="loops must not exceed 115 Nm"):
        LoopModel((), n_points=40).fit([loop])
