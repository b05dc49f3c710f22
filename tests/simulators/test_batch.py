"""Many gearboxes in the lanes of one vector, against the exact kernel."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any
from zlib import crc32

import numba
import numpy as np
import pytest

from cyclofeat.simulators import (
    Courses,
    CycloidalGearbox,
    LobeDefects,
    Rig,
    SimulationRun,
    Solver,
    many,
    motor_effects,
    simulate,
    simulate_many,
    simulation,
)
from cyclofeat.simulators.batch import runs as batch
from cyclofeat.simulators.courses import DriveAndLoad
from cyclofeat.simulators.many import simulate_each
from cyclofeat.simulators.sampling import sample_runs
from cyclofeat.simulators.simulation import GearboxLocked, Integration, SimulationDiverged, solver_within
from cyclofeat.simulators.tables import kernel_input, rest_state

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="vectors exist in compiled functions only")

STEEL = CycloidalGearbox.steel(ramp_time=0.02)
UNEVEN = STEEL.replace(lobe_pitch_errors=[1e-5] * 30)
BRAKED = STEEL.with_brake(0.02, 1e4, 0.02)
Machines = list[tuple[CycloidalGearbox, LobeDefects]]


def machines() -> Machines:
    """Machines of all rigs with 0 to 7 worn lobes on one wheel or both, and of other gearboxes."""
    drawn = [
        (rig.draw(10 * k).gearbox.replace(ramp_time=0.02), LobeDefects.worn(k, wheels=wheels, depth=depth))
        for rig in (Rig.r0(), Rig.r1(), Rig.r2())
        for k, wheels, depth in ((0, (0, 1), 1.0), (1, (0,), 1.0), (3, (1,), 0.6), (7, (0, 1), 1.0))
    ]
    return [
        *drawn,
        (STEEL.replace(contact_law="hunt_crossley", contact_damping=0.5), LobeDefects.worn(2)),
        (STEEL.replace(contact_law="conservative"), LobeDefects.worn((3, 9), depth=0.4)),
        (CycloidalGearbox.abs(ramp_time=0.02), LobeDefects.worn(4, wear_um=60, wear_share=0.3)),
        (
            BRAKED.replace(wheel_runouts=(2e-5, 1e-5j), cam_errors=(1e-5j, -2e-5), pin_clearance=1e-5),
            LobeDefects.worn(5, wear_um=100),
        ),
    ]


def lacking(each: Machines) -> Machines:
    """The same with one to three lobes removed on one wheel, one on both; two of three keep their wear."""
    changed = []
    for k, (gearbox, worn) in enumerate(each):
        removed = ((k % 15,), (2, 9), (3, 4, 11), (5 * k % 15,))[k % 4]
        left = () if k % 3 == 0 else tuple(lobe for lobe in worn.worn_lobes if lobe not in removed)
        wheels = ((0,), (1,), (0,), (0, 1))[k % 4]
        lobes = {"worn_lobes": left, "removed_lobes": removed, "wheels": wheels}
        changed.append((gearbox, dataclasses.replace(worn, **lobes)))
    return changed


def uneven(each: Machines) -> Machines:
    """The same with pitch errors of lobes by up to 30 um, as drawn for each lobe."""
    rng = np.random.default_rng(8)
    return [(g.replace(lobe_pitch_errors=rng.uniform(-3e-5, 3e-5, 30)), defects) for g, defects in each]


def rubbing(each: Machines) -> Machines:
    """The same with all kinds of friction, by different amounts."""
    rng = np.random.default_rng(5)
    rubbed = []
    for gearbox, defects in each:
        coulomb = rng.uniform(0.01, 0.1)
        friction = {
            "sleeve_friction": coulomb,
            "sleeve_static_friction": coulomb + rng.uniform(0, 0.05),
            "stribeck_speed": rng.uniform(0.02, 0.2),
            "sleeve_viscous_friction": rng.uniform(0, 5),
            "journal_friction": rng.uniform(0, 0.05),
            "friction_transition_speed": rng.uniform(0.03, 0.1),
            "bearing_transition_speed": rng.uniform(0.5, 5),
            "input_bearing_torque": rng.uniform(0, 0.1),
            "input_bearing_viscosity": rng.uniform(0, 1e-3),
            "output_bearing_torque": rng.uniform(0, 1),
            "output_bearing_viscosity": rng.uniform(0, 0.1),
        }
        rubbed.append((gearbox.replace(**friction), defects))
    return rubbed


KINDS = {
    "smooth": machines,
    "lacking": lambda: lacking(machines()),
    "uneven": lambda: uneven(machines()[::2] + lacking(machines())[1::2]),
    "rubbing": lambda: rubbing(machines()[::2] + lacking(machines())[1::2]),
    "uneven and rubbing": lambda: rubbing(uneven(machines()[::4] + lacking(machines())[1::4])),
}
# Lobes with pitch errors and friction have machine code of their own, which compiles for half a minute each:
# their equations are compared at once in double precision, and each alone in single precision.
SLOW_KINDS = [pytest.param(kind, marks=pytest.mark.slow) for kind in ("uneven", "rubbing")]
in_single = pytest.mark.parametrize("kind", ["smooth", "lacking", *SLOW_KINDS])


def courses_of(each: Machines, n: int, dt: float = 1e-5) -> list[np.ndarray]:
    return [DriveAndLoad(g, 2 * n + 1, dt / 2, 1.0 + 7 * k).piece() for k, (g, _) in enumerate(each)]


def exactly(each: Machines, courses: list[np.ndarray], solver: Solver, n: int) -> np.ndarray:
    """Torques of the exact kernel: (n, 2, n_machines)."""
    none = np.zeros(0, dtype=int)
    results = [
        Integration(g, kernel_input(g, d), course, solver.dt, solver.integrator).run(
            rest_state(g), 0, n, none
        )
        for (g, d), course in zip(each, courses, strict=True)
    ]
    return np.stack([one.torques for one in results], axis=2)


class Given:
    """A course at half steps, in the pieces that batches take."""

    def __init__(self, course: np.ndarray, solver: Solver) -> None:
        self.course = course[:, :: 1 if solver.integrator == "midpoint" else 2]
        self.n = self.course.shape[1]

    def piece(self, first: int, last: int, out: np.ndarray) -> np.ndarray:
        out[:, : last + 1 - first] = self.course[:, first : last + 1]
        return out


def integrate(
    each: Machines, courses: list[np.ndarray], solver: Solver, **options: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Results of all steps, (n_steps, N_RESULTS, lanes), and a mask of the lanes that reached their end."""
    constants = [kernel_input(*one) for one in each]
    streams = [Given(course, solver) for course in courses]
    lanes = batch.BatchIntegration(constants, streams, solver, **options)
    return np.concatenate([results.copy() for _, results in lanes.pieces()]), lanes.has_reached_end


def in_lanes(
    each: Machines,
    courses: list[np.ndarray],
    solver: Solver,
    n: int,
    lanes: int = batch.n_lanes(),
    dtype: type = np.float32,
) -> np.ndarray:
    """The same of batches."""
    parts = []
    for first in range(0, len(each), lanes):
        chosen = slice(first, first + lanes)
        results, reached = integrate(each[chosen], courses[chosen], solver, lanes=lanes, dtype=dtype)
        assert reached.all()
        assert len(results) == n
        parts.append(results[:, :2, : len(each[chosen])])
    return np.concatenate(parts, axis=2)


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(values**2, axis=0))


@pytest.mark.slow  # compiles the kernel for double precision
@pytest.mark.parametrize("kind", ["smooth", "lacking", "uneven and rubbing"])
@pytest.mark.parametrize("integrator", ["midpoint", "adams_bashforth"])
def test_double_precision_is_the_exact_kernel_but_for_the_moments_of_description(
    integrator: str, kind: str
) -> None:
    each, n, solver = KINDS[kind](), 4000, Solver(integrator=integrator)
    courses = courses_of(each, n)
    exact = exactly(each, courses, solver, n)
    error = in_lanes(each, courses, solver, n, lanes=8, dtype=np.float64) - exact
    assert np.abs(exact[:, 0]).max() > 20
    # What the frames' expansions leave: both wheels are described when either has moved.
    assert rms(error[:, 0]).max() < 2e-5
    assert rms(error[:, 1]).max() < 2e-6


@in_single
@pytest.mark.parametrize("integrator", ["midpoint", "adams_bashforth"])
def test_single_precision_errs_less_than_the_time_step(integrator: str, kind: str) -> None:
    each, n = KINDS[kind](), 2000
    solver = Solver(integrator=integrator)
    courses = courses_of(each, n)
    exact = exactly(each, courses, solver, n)
    fine = Solver(dt=solver.dt / 8)
    finely = exactly(each, courses_of(each, 8 * n, fine.dt), fine, 8 * n)[::8]
    error, of_step = rms(in_lanes(each, courses, solver, n) - exact), rms(exact - finely)
    assert (error < of_step).all(), np.argwhere(error >= of_step)


@pytest.mark.parametrize(
    ("changes", "most"),
    [({}, 1), ({"input_speed": 70.0, "stiffness_scale": 0.02}, 2), ({"contact_damping": 450.0}, 2)],
)
def test_the_step_of_an_error_budget_keeps_it(changes: dict[str, float], most: int) -> None:
    gearbox, defects, options = STEEL.replace(**changes), LobeDefects.worn(6), {"duration": 0.3}
    solver = solver_within(gearbox, 25_600.0, 2e-3)
    assert solver.dt == pytest.approx(1 / (25_600 * most))
    assert solver_within(STEEL, 1000.0, 1e-4).dt < solver_within(STEEL, 1000.0, 2e-3).dt <= 5e-5
    (run,) = simulate_many(gearbox, [defects], solver=solver, kernel="batch", **options)
    fine = simulate(gearbox, defects, solver=Solver(2.5e-6), **options)
    assert rms((run.torque_out - fine.torque_out)[2560:]) < 2e-3  # after the start
    # The exact kernel has no such rule.
    rules = Solver(2e-5, "leapfrog"), Solver(1e-5, "adams_bashforth")
    one, other = (simulate(gearbox, defects, duration=0.02, solver=rule).torque_out for rule in rules)
    assert np.array_equal(one, other)


@in_single
def test_a_lane_depends_on_nothing_but_itself(kind: str) -> None:
    each, n, solver = KINDS[kind]()[:11], 1500, Solver()
    courses = courses_of(each, n)
    together = in_lanes(each, courses, solver, n)
    order = np.random.default_rng(0).permutation(len(each))
    shuffled = in_lanes([each[k] for k in order], [courses[k] for k in order], solver, n)
    assert np.array_equal(shuffled, together[:, :, order])
    alone = in_lanes(each[6:7], courses[6:7], solver, n)
    assert np.array_equal(alone[:, :, 0], together[:, :, 6])


def test_courses_of_speed_and_load() -> None:
    courses = Courses(
        speed=lambda time: 40 + 20 * np.sin(9 * time), load_fluctuation=lambda time: 3 * np.sin(40 * time)
    )
    options = {"duration": 0.06, "courses": courses}
    defects = [LobeDefects.worn(2), LobeDefects.healthy()]
    each = simulate_many([BRAKED, STEEL], defects, kernel="batch", **options)
    for one, exact in zip(each, simulate_many([BRAKED, STEEL], defects, **options), strict=True):
        for name in ("torque_out", "torque_in", "input_angle", "output_angle", "output_speed"):
            expected = getattr(exact, name)
            assert np.abs(getattr(one, name) - expected).max() < 1e-5 * np.abs(expected).max(), name


@pytest.mark.parametrize(
    "form", [{"n_pins": 20, "shortening": 0.5}, {"n_pins": 12}, {"n_internal_sleeves": 5}]
)
def test_other_numbers_of_pins_and_sleeves(form: dict[str, float]) -> None:
    gearbox = CycloidalGearbox.steel(ramp_time=0.005, pin_radius=4e-3, **form)
    each = [(gearbox, LobeDefects.worn(3)), (gearbox, LobeDefects.healthy())]
    each.append((gearbox, LobeDefects.removed((1, 6, 7), wheels=(1,))))
    courses = courses_of(each, 1500)
    exact = exactly(each, courses, Solver(), 1500)
    assert np.abs(exact).max() > 15
    assert np.abs(in_lanes(each, courses, Solver(), 1500) - exact).max() < 2e-4


@pytest.mark.parametrize(
    ("kind", "too_much"),
    [
        (list, {"stiffness_scale": 1.0, "ramp_time": 0.0}),
        pytest.param(rubbing, {"output_bearing_viscosity": 1e5}, marks=pytest.mark.slow),
    ],
)
def test_a_lane_that_ends_leaves_its_neighbours_untouched(
    kind: Callable[[Machines], Machines], too_much: dict[str, float]
) -> None:
    each = kind([(STEEL, LobeDefects.worn(k)) for k in (2, 1)] + [(BRAKED, LobeDefects.healthy())])
    each[1] = (each[1][0].replace(**too_much), each[1][1])
    n, solver = 2000, Solver()
    courses = [DriveAndLoad(gearbox, 2 * n + 1, solver.dt / 2).piece() for gearbox, _ in each]
    results, reached = integrate(each, courses, solver)
    assert reached[:3].tolist() == [True, False, True]
    alone = in_lanes([each[0], each[2]], [courses[0], courses[2]], solver, n)
    assert np.array_equal(results[:, :2, [0, 2]], alone)


def test_failures_have_the_exact_kernels_reason() -> None:
    stiff = STEEL.replace(stiffness_scale=1.0, ramp_time=0.0)
    worn = LobeDefects.worn(1)
    arguments = [{"gearbox": gearbox, "defects": worn, "duration": 0.02} for gearbox in (STEEL, stiff)]
    found = dict(simulate_each(arguments, "batch"))
    with pytest.raises(SimulationDiverged) as error:
        simulate(stiff, worn, duration=0.02)
    assert isinstance(found[0], SimulationRun)
    assert isinstance(found[1], SimulationDiverged)
    assert str(found[1]) == str(error.value)


@pytest.mark.slow  # compiles the kernel with friction
@pytest.mark.parametrize(("integrator", "friction"), [("midpoint", 0.5), ("adams_bashforth", 0.3)])
def test_friction_that_chatters_is_told(integrator: str, friction: float) -> None:
    """As for the exact kernel (:mod:`test_friction`), and not of the steady runs beside it."""
    steep, smooth = (STEEL.replace(sleeve_friction=one) for one in (friction, 0.05))
    options = {"duration": 0.4, "solver": Solver(integrator=integrator), "kernel": "batch"}
    with pytest.warns(RuntimeWarning, match="friction chatters where surfaces stick") as caught:
        simulate_many([steep, smooth], LobeDefects.worn(7), **options)
    assert len(caught) == 1
    assert f"integrator='{integrator}' with dt = 1e-05 s" in str(caught[0].message)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulate_many([smooth], LobeDefects.worn(7), **options)
        # The first looks at 0.01 s: one of these ends before.
        dict(simulate_each([{"gearbox": smooth, "duration": one} for one in (0.005, 0.02)], "batch"))
        unchecked = Solver(integrator=integrator, check_friction=False)
        simulate_many([steep], LobeDefects.worn(7), **options | {"solver": unchecked})


def test_locking_ends_a_lane_when_it_ends_the_exact_kernels_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "LOCKING_FORCE", 50.0)  # the cams of the first two bear more, later
    each = [(STEEL, LobeDefects.worn(1)), (BRAKED, LobeDefects.healthy())]
    each += [(STEEL.replace(load_torque=1.0), LobeDefects.healthy())]
    courses = courses_of(each, 3000)
    results, reached = integrate(each, courses, Solver())
    assert reached[:3].tolist() == [False, False, True]
    for lane in range(2):
        gearbox, defects = each[lane]
        with pytest.raises(GearboxLocked) as error:
            simulate(gearbox, defects, duration=0.03, start_angle=1.0 + 7 * lane)
        ended = np.flatnonzero(np.abs(results[:, 1, lane]) > gearbox.eccentricity * 50.0)
        assert error.value.time == pytest.approx(ended[100] * 1e-5, abs=1e-9)


def test_what_a_batch_cannot_do_goes_to_the_exact_kernel() -> None:
    coarse = STEEL.replace(profile_points=900)
    gearboxes = [STEEL, coarse, BRAKED, CycloidalGearbox.steel(n_pins=8, pin_radius=4e-3)]
    runs = simulate_many(gearboxes, LobeDefects.worn(1), duration=0.01, kernel="auto")
    assert [run.kernel for run in runs] == ["batch", "exact", "batch", "exact"]
    assert [run.gearbox for run in runs] == gearboxes
    assert np.array_equal(runs[1].torque_out, simulate(coarse, LobeDefects.worn(1), duration=0.01).torque_out)
    forced = simulate_many(defects=LobeDefects.worn(1), duration=0.01, forces=True, kernel="auto")
    assert forced[0].external_forces is not None
    with pytest.raises(ValueError, match=r"'batch' does not simulate a polyline as profile \(run 1\)"):
        simulate_many(gearboxes, duration=0.01, kernel="batch")
    with pytest.raises(ValueError, match="kernel"):
        simulate_many(gearboxes, duration=0.01, kernel="fast")
    with pytest.raises(TypeError, match="durations"):
        simulate_many(gearboxes, durations=0.01, kernel="auto")


def test_options_are_those_of_simulate() -> None:
    for options in (
        {
            "solver": Solver(dt=2e-5, integrator="adams_bashforth", decimation="pick"),
            "sampling_rate": 25_000.0,
        },
        {"torque_in": False, "motion": False, "sampling_rate": 10_000.0},
    ):
        (one,) = simulate_many(BRAKED, [LobeDefects.worn(1)], duration=0.02, kernel="batch", **options)
        exact = simulate(BRAKED, LobeDefects.worn(1), duration=0.02, **options)
        assert one.dt == exact.dt
        assert one.sampling_rate == exact.sampling_rate
        assert np.abs(one.torque_out - exact.torque_out).max() < 1e-4
        assert (one.torque_in is None, one.output_angle is None) == (
            exact.torque_in is None,
            exact.output_angle is None,
        )
    with pytest.raises(ValueError, match="duration"):
        simulate_many(duration=-1.0, kernel="auto")


def test_a_motor_turns_machines_of_batches_too() -> None:
    rig = Rig(effects=motor_effects()[:-1])  # whose current has no noise and no steps
    plans = [
        rig.plan_run(
            LobeDefects.worn(n), duration=0.05, sampling_rate=8_000, quantity="motor_current", random_state=n
        )
        for n in (0, 2)
    ]
    each = zip(sample_runs(plans, kernel="batch"), sample_runs(plans, kernel="exact"), strict=True)
    for batched, exact in ((one.record(), other.record()) for one, other in each):
        assert (batched.kernel, exact.kernel) == ("batch", "exact")
        np.testing.assert_allclose(batched.motor_current, exact.motor_current, rtol=1e-3)
        np.testing.assert_allclose(batched.input_angle, exact.input_angle, atol=1e-5)


def test_batches_fit_the_lanes_and_one_form() -> None:
    few = CycloidalGearbox.steel(n_pins=12, pin_radius=4e-3)
    gearboxes = [STEEL, few, STEEL.replace(sleeve_friction=0.05), UNEVEN] * 9

    requests = {k: batch.Request.from_arguments({"gearbox": one}) for k, one in enumerate(gearboxes)}
    groups = list(batch.group_requests(requests))
    assert sorted(key for group in groups for key in group) == list(range(36))
    assert all(len({one.form for one in group.values()}) == 1 for group in groups)
    assert max(len(group) for group in groups) == min(batch.n_lanes(), 9)
    mixed = [{"duration": 0.1, "solver": Solver(dt=dt)} for dt in (1e-5, 5e-6, 1e-5)]
    groups = list(batch.group_requests({k: batch.Request.from_arguments(one) for k, one in enumerate(mixed)}))
    assert sorted(sorted(group) for group in groups) == [[0, 2], [1]]


def test_each_run_lasts_as_long_as_it_was_asked_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of several lengths share a batch, and one that would fail after its end has not failed."""
    rising = Courses(load=lambda time: 22.0 + 1e7 * np.maximum(time - 0.02, 0.0))
    stopping = {"gearbox": STEEL, "courses": rising}
    with pytest.raises(SimulationDiverged):
        simulate(**stopping, duration=0.025)
    arguments = [
        stopping | {"duration": 0.018},  # a run is longer than its result by 40 samples
        {"gearbox": BRAKED, "defects": LobeDefects.worn(2), "duration": 0.03},
        {"gearbox": STEEL, "duration": 0.01},
        {"gearbox": BRAKED, "defects": LobeDefects.worn(2), "duration": 0.02},
    ]
    together = dict(simulate_each(arguments, "batch"))
    requests = {k: batch.Request.from_arguments(one) for k, one in enumerate(arguments)}
    assert len(list(batch.group_requests(requests))) == 1
    for index, one in enumerate(arguments):
        run = together[index]
        assert isinstance(run, SimulationRun)
        assert run.kernel == "batch"
        ((_, alone),) = simulate_each([one], "batch")
        assert isinstance(alone, SimulationRun)
        for name in ("torque_out", "torque_in", "input_angle", "output_angle", "output_speed"):
            assert np.array_equal(getattr(run, name), getattr(alone, name))
    # Only the failed run is repeated, for as long as it was to last.
    repeated: list[float] = []
    exact = simulate
    monkeypatch.setattr(
        many, "simulate", lambda **given: repeated.append(given["duration"]) or exact(**given)
    )
    arguments[0] = stopping | {"duration": 0.025}
    failed = dict(simulate_each(arguments, "batch"))
    assert isinstance(failed[0], SimulationDiverged)
    assert repeated == [0.025]


def test_where_nothing_compiles_the_exact_kernel_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "compile_error", lambda: "no such vectors")
    with pytest.warns(RuntimeWarning, match="cannot be compiled here: no such vectors; the exact"):
        (run,) = simulate_many(duration=0.01, kernel="auto")
    assert run.kernel == "exact"
    with pytest.raises(RuntimeError, match="no such vectors"):
        simulate_many(duration=0.01, kernel="batch")
    monkeypatch.undo()
    assert batch.compile_error() is None


def test_the_kernel_knows_which_sources_it_was_compiled_with() -> None:
    """numba's cache on disk looks at one file: a change of another has to change the kernel's, too."""
    folder = Path(batch.__file__).parent
    sources = [folder.parent / "_outline.py"]
    sources += [folder / f"{name}.py" for name in ("_tables", "_vectors", "_lanes", "_frames")]
    checksum = crc32(b"".join(path.read_bytes() for path in sources))
    assert (
        f"SOURCES_CHECKSUM = {checksum:#x}\n".lower()
        in (folder / "_kernel.py").read_text(encoding="utf-8").lower()
    )
