"""Recordings of a rig at several conditions: sorted, cut, resampled, split, compared with one verdict."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from short_records import GEARBOX, N_SAMPLES, RATE, short

from cyclofeat.gap import Condition, GapResult, GapSettings, World, compare_recordings, hold_out
from cyclofeat.gap.measured import MeasuredRig
from cyclofeat.gap.summaries.turns import MeasuredTurns
from cyclofeat.gap.where.locate import locate, locate_all
from cyclofeat.gap.world.cells import turn_samples
from cyclofeat.gap.world.world import NOISE_AND_DRIFT
from cyclofeat.recordings import Recording
from cyclofeat.simulators import Gain, Hum, Noise, Offset, Rig

NOISE = np.random.default_rng(0).normal(22, 0.1, (12, 30_000))
MODEL = Rig()


def made(speed: float | None = 500, load: float | None = 22, i: int = 0, **more: Any) -> Recording:
    """A recording of noise, 2.3 s of 12.8 kHz."""
    return Recording(
        NOISE[i], **{"sampling_rate": 12_800, "speed_rpm": speed, "load_nm": load, "run": f"r{i}"} | more
    )


# Kinematics


def test_set_points_that_differ_little_are_one_condition_and_reverse_is_another() -> None:
    stated = [(500, 22), (501, 22.2), (500.5, 21.9), (600, 22), (500, 23), (500, 22)]
    recordings = [made(*at, i) for i, at in enumerate(stated)]
    recordings[-1] = recordings[-1].replace(torque=-recordings[-1].torque)
    rig = MeasuredRig.of(recordings, MODEL)
    # The median of the speeds is that of all recordings at it.
    assert rig.conditions == (
        Condition(500, 22), Condition(500, 23), Condition(600, 22), Condition(500, 22, -1)
    )  # fmt: skip
    assert [len(rig.at(condition)) for condition in rig.conditions] == [3, 1, 1, 1]
    assert not rig.warnings
    shuffled = MeasuredRig.of(recordings[::-1], MODEL)
    assert shuffled.conditions == rig.conditions
    assert shuffled.recording_conditions == rig.recording_conditions[::-1]


def test_recordings_held_out_take_the_conditions_of_those_fitted() -> None:
    """Speeds that were measured differ a little between the two."""
    fitted = MeasuredRig.of([made(499.8), made(500.6)], MODEL)
    held = [made(501.1, 22.1), made(510), made(500, 23), made(500).replace(torque=-NOISE[0])]
    alone = MeasuredRig.of(held, MODEL)
    assert not set(fitted.conditions) & set(alone.conditions)
    found = MeasuredRig.of(held, MODEL, beside=fitted).recording_conditions
    assert found == (fitted.conditions[0], *alone.recording_conditions[1:])


def test_a_load_that_is_not_stated_is_the_model_s() -> None:
    rig = MeasuredRig.of([made(load=None), made(load=30)], MODEL)
    assert {condition.load_nm for condition in rig.conditions} == {MODEL.gearbox.load_torque, 30}
    assert rig.warnings[0].startswith("1 of 2 recordings state no load")


def test_few_assemblies_are_a_warning_and_one_is_a_setting() -> None:
    def of(*names: str) -> MeasuredRig:
        return MeasuredRig.of([made(assembly=name) for name in names], MODEL)

    assert "2 assemblies" in of("a", "a", "b").warnings[0]
    for names, expected in ((("a", "b"), False), (("a", "a"), True), (("a",), False)):
        rig = of(*names)
        assert not rig.warnings
        comparison = rig.comparison(rig.conditions[0], World(), GapSettings(random_state=0))
        assert comparison.one_assembly is expected


def test_what_cannot_be_used_is_refused_by_name() -> None:
    for recordings, rate, message in (
        ([], None, "at least one recording"),
        ([made(), made(speed=None)], None, "1 of 2 recordings state no nominal speed: give speed_rpm="),
        ([made(n_lobes=11)], None, "the model's discs have 15 lobes, those of the recordings 11"),
        ([made(), made(n_lobes=11)], None, "n_lobes must be the same"),
        ([made(quantity="motor_current")], None, "must be 'output_torque' or 'input_torque', got"),
        ([made()], 25_600, "25600 Hz or more, the rate of the posterior's world, got 12800 Hz"),
        ([made()], 0, "sampling_rate must be positive"),
    ):
        with pytest.raises(ValueError, match=message):
            MeasuredRig.of(recordings, MODEL, rate)
    with pytest.raises(TypeError, match="recordings must"):
        MeasuredRig.of([NOISE[0]], MODEL)
    short_one = MeasuredRig.of([made().crop(0, 1.8)], MODEL)
    assert turns_at(short_one, short_one.conditions[0]).windows.shape == (1, 23_040)
    with pytest.raises(ValueError, match=r"'r0'.* is too short: an output turn and 3 % more, 1\.8\d* s"):
        short_one.session()


def test_torque_on_the_input_counts_times_the_reduction_and_is_the_simulated_quantity() -> None:
    at_output = MeasuredRig.of([made()], MODEL)
    at_input = MeasuredRig.of([made().replace(torque=NOISE[0] / 15, quantity="input_torque")], MODEL)
    np.testing.assert_allclose(at_input.session().values, at_output.session().values, rtol=1e-3, atol=1e-3)
    assert at_input.conditions == at_output.conditions
    assert any("multiplied by 15" in warning for warning in at_input.warnings)
    world = at_input.world(World())
    assert World.from_dict(world.to_dict()).quantity == "input_torque"
    comparison = at_input.comparison(at_input.conditions[0], world, GapSettings(random_state=0))
    made_by_model = comparison.population.record(2, np.random.SeedSequence(3))
    without = comparison.replace(quantity="output_torque").population.record(2, np.random.SeedSequence(3))
    # By the reduction both are the load, but the lobes' share in each is another.
    assert made_by_model.torque.mean() == pytest.approx(without.torque.mean(), rel=0.1)
    assert np.corrcoef(made_by_model.torque, without.torque)[0, 1] < 0.9
    with pytest.raises(ValueError, match=r"must be 'output_torque', from which .* got 'input"):
        MeasuredRig.of([made(quantity="input_torque")], MODEL, quantity="output_torque")
    with pytest.raises(ValueError, match="quantity must be 'output_torque' or 'input_torque', got 'motor"):
        World(quantity="motor_current")


# Windows, sessions and comparisons


def turns_at(rig: MeasuredRig, condition: Condition) -> MeasuredTurns:
    return rig.turns(rig.comparison(condition, World(), GapSettings(random_state=0)))


def test_turns_hold_what_all_recordings_state() -> None:
    """Torque positive for a load that brakes, angle of the input although the tachometer was on a disc."""
    angle = 2 * np.pi * 500 / 60 * np.arange(30_000) / 12_800
    known = {"defect_count": 3, "angle": -angle / 15, "angle_of": "disc"}
    recordings = [made(i=0, **known), made(i=1, **known | {"defect_count": 0})]
    recordings[1] = recordings[1].replace(torque=-recordings[1].torque)
    rig = MeasuredRig.of(recordings, MODEL)
    forward, reverse = (turns_at(rig, condition) for condition in rig.conditions)
    assert np.array_equal(forward.windows, NOISE[:1, :23_040].astype(np.float32))
    assert np.array_equal(reverse.windows, NOISE[1:2, :23_040].astype(np.float32))
    assert (forward.counts.tolist(), reverse.counts.tolist()) == ([3], [0])
    assert forward.speeds == pytest.approx(500 / 60, rel=1e-9)
    session = rig.session()
    assert session.counts.tolist() == [3, 0]
    assert session.speeds_rpm == pytest.approx([500, 500])
    assert session.conditions.tolist() == [[500, 22, 1], [500, 22, -1]]
    one_lacks = MeasuredRig.of([*recordings, made(i=2)], MODEL)
    assert turns_at(one_lacks, rig.conditions[0]).counts is None
    assert one_lacks.session().counts is one_lacks.session().speeds_rpm is None
    assert not rig.known_as(one_lacks).has_counts
    assert rig.known_as(rig).has_tachometer
    assert rig.part([1]).conditions == rig.conditions[1:]


def test_a_session_of_both_directions_has_equal_summaries_for_mirrored_torque() -> None:
    forward = made()
    rig = MeasuredRig.of([forward, forward.replace(torque=-forward.torque)], MODEL)
    assert np.array_equal(*rig.session().values)


def test_a_comparison_has_the_model_at_the_condition_and_the_world_s_floor() -> None:
    world = World(rig=Rig(effects=[Noise(0.3)]), defect_counts=(0, 4), wheels=((0,),))
    rig = MeasuredRig.of([made(400, 12).replace(torque=-NOISE[0])], world.rig)
    settings = GapSettings(n_bank=31, random_state=5)
    comparison = rig.comparison(rig.conditions[0], world, settings)
    gearbox = comparison.rig.gearbox
    assert (round(gearbox.input_speed * 30 / np.pi, 9), gearbox.load_torque) == (400, 12)
    assert comparison.direction == -1
    assert (comparison.n_bank, comparison.random_state, comparison.defect_counts) == (31, 5, (0, 4))
    assert rig.turns(comparison).windows.shape == (1, comparison.n_samples)
    simulated = comparison.population.rig.effects
    assert [effect.effect_id for effect in simulated].count("noise") == 1
    assert NOISE_AND_DRIFT[1] in simulated


def test_only_what_has_a_sign_on_the_signal_differs_in_reverse(simulations: Path) -> None:
    def mean(direction: int, *effects: Any) -> np.ndarray:
        rig = Rig(GEARBOX, effects)
        return short(rig=rig, direction=direction, may_differ=(), cache=simulations).bank(2, [0]).X

    plain, gained = mean(1), mean(1, Gain(1.5))
    assert np.array_equal(mean(-1), plain)
    assert mean(-1, Gain(1.5)) == pytest.approx(gained)
    assert mean(1, Offset(2.0)) == pytest.approx(plain + 2)
    assert mean(-1, Offset(2.0)) == pytest.approx(plain - 2)
    with pytest.raises(ValueError, match="direction must be 1 or -1, got 0"):
        short(direction=0)


# Rates


@pytest.mark.parametrize("rate", [25_600, 44_100, 12_801])
def test_higher_rates_become_the_posterior_s(rate: int) -> None:
    """A line at 100 Hz and a constant keep size and phase, also at the ends; the angle its speed."""
    time = np.arange(2 * rate) / rate
    wave = 22 + np.sin(2 * np.pi * 100 * time)
    fast = Recording(wave, rate, speed_rpm=500, load_nm=22, angle=2 * np.pi * 8 * time)
    rig = MeasuredRig.of([fast, made()], MODEL, 12_800)
    found = rig.recordings[0]
    assert rig.sampling_rate == found.sampling_rate == 12_800
    assert f"resampled from {rate} to 12800 Hz" in rig.warnings[0]
    at = np.arange(found.n_samples) / 12_800
    inner = slice(100, -100)
    assert found.torque[inner] == pytest.approx((22 + np.sin(2 * np.pi * 100 * at))[inner], abs=0.002)
    assert np.ptp(found.torque) < 2.2
    assert found.mean_input_speed() == pytest.approx(8, rel=2e-5)
    assert found.duration == pytest.approx(2, abs=2e-4)
    assert rig.recordings[1] is not fast
    # Without a rate the lowest is taken.
    assert MeasuredRig.of([fast, made()], MODEL).sampling_rate == 12_800


def test_a_rate_rounded_in_a_file_is_the_same_rate() -> None:
    rig = MeasuredRig.of([made(sampling_rate=12_800 * (1 + 1e-8))], MODEL, 12_800)
    assert not rig.warnings
    assert np.array_equal(rig.recordings[0].torque, NOISE[0])


# Held out


def test_the_middle_of_speeds_and_loads_is_held_out() -> None:
    recordings = [made(speed, load) for speed in (400, 500, 501, 600, 700) for load in (10, 20, 30)]
    for by, expected in (("speed", {600}), ("load", {20})):
        fitted, held = hold_out(recordings, by)
        stated = {one.speed_rpm if by == "speed" else one.load_nm for one in held}
        left = {one.speed_rpm if by == "speed" else one.load_nm for one in fitted}
        assert stated == expected
        assert min(left) < min(stated) <= max(stated) < max(left)
        assert len(fitted) + len(held) == len(recordings)
    for by, message in (("speed", "at 3 speeds or more.*got 2: 400, 600 RPM"), ("load", "got 1: 22 Nm")):
        with pytest.raises(ValueError, match=message):
            hold_out([made(400), made(600), made(600)], by)
    with pytest.raises(ValueError, match="load_nm of every recording, 1 of 3 state none"):
        hold_out([made(), made(load=None), made()], "load")


def test_a_share_is_held_out_of_every_count_and_condition() -> None:
    kinds = [(speed, count) for speed in (400, 600) for count in (0, 5)]
    recordings = [made(speed, defect_count=count, i=i) for speed, count in kinds for i in range(4)]
    fitted, held = hold_out(recordings, 0.25, random_state=0)
    assert sorted((one.speed_rpm, one.defect_count) for one in held) == kinds
    assert len(fitted) == 12
    other = hold_out(recordings, 0.25, random_state=1)[1]
    assert [one.run for one in other] != [one.run for one in held]
    again = hold_out(recordings, 0.25, random_state=0)[1]
    assert [one.run for one in again] == [one.run for one in held]


def test_assemblies_are_held_out_whole() -> None:
    recordings = [made(speed, assembly=name) for name in "abcd" for speed in (400, 600)]
    fitted, held = hold_out(recordings, 0.5, random_state=0)
    names = [{one.assembly for one in part} for part in (fitted, held)]
    assert len(names[0]) == len(names[1]) == 2
    assert not names[0] & names[1]
    for by in (1.5, 0.0, "torque"):
        with pytest.raises(ValueError, match="by must be a share between 0 and 1, speed or load"):
            hold_out(recordings, by)
    with pytest.raises(ValueError, match=r"by 0\.1 leaves 8 of 8 recordings to fit, of 4 assemblies"):
        hold_out(recordings, 0.1, random_state=0)


# Where, over conditions

WORLD = World(rig=Rig(GEARBOX), effects=(Hum(),), most=1, defect_counts=(0, 3))
SETTINGS = GapSettings(random_state=0, n_bank=24, n_permutations=499, alpha=0.05)


def simulated_at(
    speeds: tuple[float, ...], cache: Path, *effects: Any, seed: int = 7, n: int = 6
) -> list[Recording]:
    """Recordings at each speed, as the world's model gives them, with effects in it."""
    found = []
    for speed in speeds:
        empty = Recording(22 + NOISE[0, :10], RATE, speed_rpm=speed, load_nm=22)
        rig = MeasuredRig.of([empty], WORLD.rig)
        comparison = rig.comparison(rig.conditions[0], WORLD, dataclasses.replace(SETTINGS, cache=cache))
        source = comparison.replace(rig=comparison.rig.with_added(*effects))
        bank = source.bank(n, (0, 3), random_state=seed)
        found += [
            Recording(x, RATE, speed_rpm=speed, load_nm=22, defect_count=int(count))
            for x, count in zip(bank.X, bank.counts, strict=True)
        ]
    return found


@pytest.mark.slow
def test_one_condition_that_disagrees_is_found_at_the_adjusted_p(simulations: Path) -> None:
    settings = dataclasses.replace(SETTINGS, cache=simulations)
    usual, with_hum = simulated_at((1500,), simulations), simulated_at((1400,), simulations, Hum(1.0))
    rig = MeasuredRig.of([*usual, *with_hum], WORLD.rig)
    alone = simulated_at((1450,), simulations)[:1]
    found = locate_all(MeasuredRig.of([*usual, *with_hum, *alone], WORLD.rig), WORLD, settings)
    assert [one.where.verdict for one in found] == ["disagree", "unresolved"]
    assert [round(one.comparison.kinematics.input_speed_hz * 60) for one in found] == [1400, 1500]
    assert all(one.where.alpha == 0.025 and one.where.n_permutations == 998 for one in found)
    result = GapResult(where=[one.where for one in found], rig=WORLD.rig)
    assert result.verdict == "disagree"
    assert result.p == 2 * found[0].where.p <= settings.alpha
    # As of each condition by itself.
    comparison = rig.comparison(rig.conditions[0], WORLD, settings)
    by_itself = locate(comparison, rig.turns(comparison), alpha=0.025, n_permutations=998)
    assert by_itself.where.family_p == found[0].where.family_p
    with pytest.raises(ValueError, match="at least 2 recordings of one condition.*got 1 at 1 conditions"):
        locate_all(rig.part([0]), WORLD, settings)


@pytest.mark.slow
def test_recordings_of_another_simulator_take_the_place_of_simulated_ones(
    simulations: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is simulated; counts and conditions are those that both have."""
    measured = simulated_at((1400, 1500), simulations)
    other = simulated_at((1500,), simulations, seed=8, n=48)
    monkeypatch.setattr("cyclofeat.gap.comparison.simulate_bank", None)

    def compare(simulated: list[Recording], first: int = 0) -> Any:
        settings = dataclasses.replace(SETTINGS, pictures=False)
        return compare_recordings(measured[first:], simulated, settings=settings)

    same = compare(other)
    assert same.verdict == "unresolved"
    (where,) = same.where
    assert (where.n_recordings, where.n_simulated, where.condition) == (6, 48, Condition(1500, 22))
    assert any(words.endswith("two recordings there: 1400 RPM, 22 Nm") for words in same.warnings)
    assert not any("look surer" in words for words in same.warnings)
    wave = np.sin(2 * np.pi * 50 * np.arange(N_SAMPLES) / RATE)
    assert compare([one.replace(torque=one.torque + wave) for one in other]).verdict == "disagree"
    unknown = compare([one.replace(defect_count=None) for one in other[:12]], first=6)
    for words in ("counts of worn lobes are not known", "12 simulated recordings .* look surer"):
        assert any(re.search(words, warning) for warning in unknown.warnings)
    one_assembly = [one.replace(assembly="a") for one in measured]
    found = compare_recordings(one_assembly, other, settings=SETTINGS)
    assert any("one assembly" in words for words in found.warnings)
    assert {overlay.kind for overlay in found.overlays} == {"spectrum", "orders", "distribution"}
    for simulated, message in (
        ([one for one in other if one.defect_count == 0], "1500 RPM, 22 Nm, got none with 3 worn lobes"),
        (other[:1], "and 2 simulated ones"),
        ([one.replace(n_lobes=11) for one in other], "n_lobes must be the same"),
    ):
        with pytest.raises(ValueError, match=message):
            compare(simulated)


def test_other_discs_are_compared_too() -> None:
    """Of eleven lobes: no model is needed."""
    recordings = [made(n_lobes=11, i=i) for i in range(8)]
    found = compare_recordings(
        recordings[:4], recordings[4:], settings=GapSettings(random_state=0, pictures=False)
    )
    assert found.rig.gearbox.n_lobes == 11
    assert found.verdict != "disagree"


def test_sessions_hold_one_turn_of_each_recording() -> None:
    """What follows the first output turn and its 3 % is not looked at."""
    rig = MeasuredRig.of([made()], MODEL)
    needed = turn_samples(rig.comparison(rig.conditions[0], World(), GapSettings(random_state=0)).kinematics)
    other = made().torque.copy()
    other[needed:] = 0.0
    changed = MeasuredRig.of([made().replace(torque=other)], MODEL)
    assert np.array_equal(changed.session().values, rig.session().values)


def test_a_world_holds_the_conditions_of_the_recordings() -> None:
    stated = [(100, 5, 0), (200, 8, 9)]
    recordings = [made(speed, load, defect_count=count) for speed, load, count in stated]
    world = MeasuredRig.of(recordings, MODEL).world(World(defect_counts=(0, 1)))
    assert world.speeds_rpm == pytest.approx((90, 220))
    assert world.loads_nm == pytest.approx((4.5, 8.8))
    assert world.defect_counts == (0, 1, 9)
    assert world.sampling_rate == 12_800
    fast = MeasuredRig.of([made(sampling_rate=51_200)], MODEL).world(World())
    assert fast.sampling_rate == 25_600
    # One condition is a world too.
    assert fast.loads_nm == pytest.approx((19.8, 24.2))


def test_doubts_name_what_limits_the_conclusions() -> None:
    known = {"defect_count": 0, "angle": np.arange(30_000) * 0.004}
    several = MeasuredRig.of([made(i=i, **known) for i in range(4)], MODEL)
    assert several.doubts == []
    few = MeasuredRig.of([made(), made(i=1).replace(torque=np.minimum(NOISE[1], 22.0))], MODEL).doubts
    for words, sentence in zip(
        ("2 recordings: ", "counts of worn lobes", "no tachometer", "1 of 2 .* clipped: .* largest"),
        few,
        strict=True,
    ):
        assert re.search(words, sentence)
    # Rounded torque repeats its largest value too, now and then.
    rounded = [one.replace(torque=np.round(one.torque, 1)) for one in several.recordings]
    assert MeasuredRig.of(rounded, MODEL).doubts == []


def test_recordings_at_the_end_of_the_sensor_s_range_are_left_out_where_others_reach_it() -> None:
    clipped, saturated = np.minimum(NOISE[1], 22.0), np.full(NOISE[1].size, 22.0)
    given = [made(), made(i=1).replace(torque=clipped), made(i=2).replace(torque=saturated)]
    rig = MeasuredRig.of(given, MODEL)
    assert rig.recordings == tuple(given[:2])
    (warning,) = rig.warnings
    assert "1 of 3 recordings stay at 22 Nm" in warning
    # Recordings held out of the rig have its sensor.
    held = MeasuredRig.of([made(i=3), given[2]], MODEL, beside=rig)
    assert len(held.recordings) == 1
    assert "1 of 2 recordings stay at 22 Nm" in held.warnings[0]
    assert len(MeasuredRig.of([given[2]], MODEL, beside=rig).recordings) == 1
    # A value that no other recording ends at is no range: the sensor may be dead.
    for others in (given[:1], [given[1].replace(torque=clipped + 1.0)]):
        kept = MeasuredRig.of([*others, given[2]], MODEL)
        assert len(kept.recordings) == 2
        assert not kept.warnings
