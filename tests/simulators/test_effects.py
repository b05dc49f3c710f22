"""Effects one by one, each against an oracle that knows nothing of it."""

from __future__ import annotations

import functools
import itertools
import math

import numpy as np
import pytest
from scipy import signal, stats
from scipy.optimize import brentq
from sklearn.base import clone

from cyclofeat import simulators
from cyclofeat.simulators import CycloidalGearbox, simulate
from cyclofeat.simulators.effects import (
    BearingFriction,
    BrakeRotor,
    CamRunOut,
    Clearance,
    Clipping,
    ClockError,
    ContactDampingForm,
    Drift,
    Effect,
    Gain,
    Hum,
    LobePitchErrors,
    LostSamples,
    Noise,
    Offset,
    PinErrors,
    ProportionalDrift,
    Quantisation,
    Rattle,
    RunOut,
    Scale,
    ShaftLine,
    SleeveFriction,
    SpeedWander,
    StickSlip,
    TorqueMeterLowPass,
    WarmUp,
    known_effects,
)
from cyclofeat.simulators.effects.effect import PLACES, TorqueContext, draw_for_assembly
from cyclofeat.simulators.effects.library import look_alikes
from cyclofeat.simulators.tables import stiffness_factor

FS = 25_600.0
STEEL = CycloidalGearbox.steel()
EVERY = [effect for effect in known_effects().values() if effect.vector_names()]
every_effect = pytest.mark.parametrize("effect", EVERY, ids=lambda effect: effect.effect_id)


def torque_of(effect, torque, seed=0, sampling_rate=FS, **context):
    """The torque after an effect, of a record at nominal speed."""
    angle = STEEL.input_speed * np.arange(len(torque)) / sampling_rate
    given = TorqueContext(**{"gearbox": STEEL, "input_angle": angle, **context})
    return effect.change_torque(torque, sampling_rate, np.random.default_rng(seed), given)


def gearbox_of(effect, gearbox=STEEL, seed=0):
    return effect.change_gearbox(gearbox, np.random.default_rng(seed))


def wave(frequency, n=51_200, amplitude=1.0, phase=0.3, sampling_rate=FS):
    return amplitude * np.sin(2 * np.pi * frequency * np.arange(n) / sampling_rate + phase)


def phasor(values, frequency, sampling_rate=FS):
    """Complex amplitude of the cosine at a frequency, by projection on whole periods."""
    turns = 2j * np.pi * frequency * np.arange(len(values)) / sampling_rate
    return 2 * np.mean(values * np.exp(-turns))


# What all of them state


def test_known_effects_are_in_chain_order_and_cannot_be_changed():
    known = known_effects()
    places = [PLACES.index(effect.place) for effect in known.values()]
    assert places == sorted(places)
    assert [effect.effect_id for effect in known.values()] == list(known)
    assert set(known_effects(proposed=True)) < set(known)
    assert len(known_effects(proposed=True)) == 21
    with pytest.raises(TypeError):
        known["mine"] = Hum()
    known["hum"].set_params(amplitude_nm=9.0)
    assert known_effects()["hum"] == Hum()


def test_look_alikes_are_grouped_with_the_proposed_first():
    assert look_alikes() == (
        ("gain", "offset", "load_scale"),
        ("load_drift", "sensor_drift", "proportional_drift"),
        ("load_warm_up", "sensor_warm_up"),
        ("clock_error", "speed_scale"),
    )


@every_effect
def test_each_states_itself_with_defaults_and_priors_within_the_bounds(effect):
    text = type(effect).__doc__
    assert effect.summary.endswith(".")
    assert len(effect.summary) <= 110
    assert effect.separated_by
    assert effect._check() is effect
    for name, parameter in effect.parameters.items():
        assert text.count(f"\n{name} : ") == 1
        assert parameter.low <= getattr(effect, name) <= parameter.high
        if parameter.neutral is not None:
            assert parameter.low <= parameter.neutral <= parameter.high
        if parameter.prior is not None:
            low, high = parameter.prior.ppf((0.001, 0.999))
            assert parameter.low < low < high < parameter.high
            assert not parameter.log or parameter.prior.dist.name == "loguniform"


def test_documentation_is_completed_from_the_table_of_parameters():
    text = Hum.__doc__
    assert "of an input at 500 RPM.\n\nSeparating measurement: a record with the motor off" in text
    entry = (
        "\n----------\namplitude_nm : float or (low, high), default 0.2\n    In Nm, 0 to 1000; 0 is neutral."
    )
    assert text.index(entry) < text.index("Set by hand") < text.index("\nharmonics : ")
    assert text.count("Parameters\n---") == 1
    assert ProportionalDrift.__doc__.index("\nrelative : ") < ProportionalDrift.__doc__.index("Examples\n---")


@every_effect
def test_neutral_changes_nothing_to_the_last_bit(effect):
    values = {name: one.neutral for name, one in effect.parameters.items() if one.neutral is not None}
    form = {"form": "paper"} if isinstance(effect, ContactDampingForm) else {}
    neutral = effect.with_parameters(**values, **form)
    torque = np.random.default_rng(3).normal(22, 3, 4000)
    torque[7] = -0.0
    out = torque_of(neutral, torque)
    assert out.tobytes() == torque.tobytes()
    assert neutral.resample(torque, FS).tobytes() == torque.tobytes()
    assert neutral.samples_needed(4000) == 4000
    assert gearbox_of(neutral) == STEEL
    random = np.random.default_rng(0)
    for hook in (neutral.load_fluctuation, neutral.speed_fluctuation):
        assert hook(STEEL, 1.0, random) is None


@every_effect
def test_by_default_each_does_something_and_leaves_what_it_is_given(effect):
    torque = np.random.default_rng(3).normal(22, 3, 4000)
    given = torque.copy()
    random = np.random.default_rng(0)
    acts = {
        "gearbox": gearbox_of(effect) != STEEL,
        "load": effect.load_fluctuation(STEEL, 1.0, random) is not None,
        "speed": effect.speed_fluctuation(STEEL, 1.0, random) is not None,
        "torque": not np.array_equal(torque_of(effect, torque), torque),
    }
    assert sum(acts.values()) == 1, acts
    assert effect.needs_simulation() != acts["torque"]
    np.testing.assert_array_equal(torque, given)
    np.testing.assert_array_equal(torque_of(effect, torque, 5), torque_of(effect, torque, 5))
    assert gearbox_of(effect, seed=5) == gearbox_of(effect, seed=5)


@every_effect
def test_clone_and_parameters(effect):
    again = clone(effect)
    assert again == effect == eval(repr(effect), vars(simulators))
    assert again is not effect
    assert hash(again) == hash(effect)
    assert again.get_params() == effect.get_params()
    first = next(iter(effect.parameters))
    low, high = effect.parameters[first].low, min(effect.parameters[first].high, 1e6)
    middle = 0.4 * low + 0.6 * high
    changed = effect.with_parameters(**{first: middle})
    assert getattr(changed, first) == middle
    assert changed != effect == again
    assert again.set_params(**{first: middle}) == changed
    with pytest.raises(ValueError, match="Invalid parameter 'zzz'"):
        effect.with_parameters(zzz=1)


# Parameters as a vector


@every_effect
def test_vector_comes_back_to_rounding(effect):
    random = np.random.default_rng(1)
    names = effect.vector_names()
    low, high = effect.vector_bounds()
    assert low.shape == high.shape == (len(names),)
    for _ in range(20):
        drawn = effect.draw_parameters(random)
        vector = drawn.to_vector()
        assert np.all((low <= vector) & (vector <= high))
        back = effect.from_vector(vector)
        for name in names:
            assert getattr(back, name) == pytest.approx(getattr(drawn, name), rel=1e-12)
            expected = getattr(drawn, name)
            at = vector[names.index(name)]
            assert at == pytest.approx(math.log(expected) if effect.parameters[name].log else expected)


@every_effect
def test_every_fitted_parameter_reaches_the_effect(effect):
    """A parameter that is silently not applied is the trap of fitters."""
    torque = np.random.default_rng(3).normal(22, 3, 4000)
    start = effect.draw_parameters(np.random.default_rng(2))

    def outcome(one):
        parts = (
            hook(STEEL, 1.0, np.random.default_rng(0))
            for hook in (one.load_fluctuation, one.speed_fluctuation)
        )
        courses = [part(np.linspace(0.3, 1, 500)).tolist() for part in parts if part is not None]
        return gearbox_of(one), torque_of(one, torque).tolist(), courses

    for index, _ in enumerate(effect.vector_names()):
        step = np.zeros(start.to_vector().size)
        step[index] = 0.1 if isinstance(effect, LostSamples) else 1e-3  # lost are whole samples
        assert outcome(start.from_vector(start.to_vector() + step)) != outcome(start)


def test_bounds_come_back_exactly_and_beyond_them_nothing_is_clipped():
    brake = BrakeRotor()
    low, high = brake.vector_bounds()
    vector = brake.to_vector()
    for index, name in enumerate(brake.vector_names()):
        for ends, bound in ((high, brake.parameters[name].high), (low, brake.parameters[name].low)):
            if not math.isfinite(ends[index]):
                continue
            at = vector.copy()
            at[index] = ends[index]
            assert getattr(brake.from_vector(at), name) == bound
            at[index] += 1e-6 if ends is high else -1e-6
            with pytest.raises(ValueError, match=f"{name} of brake_rotor must lie between"):
                brake.from_vector(at)
    with pytest.raises(ValueError, match=r"vector of brake_rotor must hold 3 values, got \(2,\)"):
        brake.from_vector([0.0, 1.0])
    with pytest.raises(ValueError, match="inertia of brake_rotor must be above 0 and finite"):
        brake.with_parameters(inertia=0.0).to_vector()
    with pytest.raises(ValueError, match="inertia of brake_rotor must be a number to be fitted"):
        brake.with_parameters(inertia=(0.01, 0.02)).to_vector()
    with pytest.raises(ValueError, match="must lie between"):
        Offset().from_vector([math.nan])


@pytest.mark.slow
def test_draws_follow_the_prior_and_ranges_are_log_uniform_or_uniform():
    random = np.random.default_rng(8)
    both = TorqueMeterLowPass((100, 1600)), Offset((-0.5, 1.5))
    for effect, name, draw, expected in (
        *((BrakeRotor(), name, Effect.draw_parameters, p.prior) for name, p in BrakeRotor.parameters.items()),
        (Offset(), "offset_nm", Effect.draw_parameters, stats.norm(0, 0.5)),
        (both[0], "cutoff_hz", draw_for_assembly, stats.loguniform(100, 1600)),
        (both[1], "offset_nm", draw_for_assembly, stats.uniform(-0.5, 2)),
    ):
        drawn = [draw(effect, random) for _ in range(400)]
        assert stats.kstest([getattr(one, name) for one in drawn], expected.cdf).pvalue > 1e-3
        assert not drawn[0].has_spread
    assert both[0].has_spread
    assert draw_for_assembly(TorqueMeterLowPass((250, 250)), random).cutoff_hz == 250.0
    assert draw_for_assembly(PinErrors((0, 0)), random).rms == 0


def test_a_range_changes_nothing_else_of_an_assembly():
    fixed = draw_for_assembly(BrakeRotor(0.01, (1e3, 1e4)), np.random.default_rng(6))
    drawn = draw_for_assembly(BrakeRotor((0.01, 0.03), (1e3, 1e4)), np.random.default_rng(6))
    assert fixed.stiffness == drawn.stiffness
    assert fixed.inertia == 0.01 < drawn.inertia < 0.03


# Bad input


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (Hum(amplitude_nm="0.2"), r"amplitude_nm of hum must be a number of Nm, a range .* got '0.2'"),
        (Hum(amplitude_nm=True), "amplitude_nm of hum must be a number of Nm.* got True"),
        (Hum(amplitude_nm=-0.1), "amplitude_nm of hum must lie between 0 and 1000 Nm, got -0.1"),
        (Hum(amplitude_nm=math.nan), "amplitude_nm of hum must lie between .* got nan"),
        (Hum(amplitude_nm=(0.3, 0.1)), r"with low <= high, got \(0.3, 0.1\)"),
        (Hum(amplitude_nm=(0, 0.1)), "as a range, must begin above 0"),
        (Hum(amplitude_nm=(0.1, 0.2, 0.3)), r"\(low, high\) or a distribution, got \(0.1, 0.2, 0.3\)"),
        (Hum(harmonics=()), "harmonics of hum must hold finite numbers"),
        (Hum(harmonics=(1, math.inf)), "harmonics of hum must hold finite numbers"),
        (Hum(phase="random"), "phase of hum must be a number of rad or None, got 'random'"),
        (TorqueMeterLowPass((100, math.inf)), "torque_meter_low_pass, as a range, must begin .* end finite"),
        (TorqueMeterLowPass(order=2.0), "order of torque_meter_low_pass must be a whole number, got 2.0"),
        (Drift(order=0), "order of load_drift must be at least 1, got 0"),
        (Drift(of="brake"), "'of' of Drift must be 'load' or 'sensor', got 'brake'"),
        (SpeedWander(phase=math.nan), "phase of speed_wander must be"),
        (BrakeRotor(damping_ratio=1.0), "damping_ratio of brake_rotor must lie between 0 and 0.99, got 1.0"),
        (ContactDampingForm("hertz"), "form of contact_damping_form must be 'paper' or .* got 'hertz'"),
        (LostSamples(fill="x"), "fill of lost_samples must be one of 'hold', 'zero', 'cut', got 'x'"),
        (Quantisation(1.0, 0.5), "full_scale_nm must be at least lsb_nm 1, got 0.5"),
    ],
    ids=str,
)  # fmt: skip
def test_bad_parameters_are_named(effect, message):
    with pytest.raises((TypeError, ValueError), match=message):
        effect._check()


def test_what_cannot_be_is_refused():
    torque = np.zeros(100)
    with pytest.raises(ValueError, match="cutoff_hz .* below the Nyquist frequency 500 Hz, got 500.0"):
        torque_of(TorqueMeterLowPass(500.0), torque, sampling_rate=1000.0)
    with pytest.raises(ValueError, match="harmonics must lie below the Nyquist frequency 75 Hz, got 100 Hz"):
        torque_of(Hum(harmonics=(1, 0.5)), torque, sampling_rate=150.0)


# Geometry and contact


def test_pin_errors_have_their_rms_and_add_to_those_there():
    many = [gearbox_of(PinErrors(10e-6), seed=seed) for seed in range(60)]
    errors = np.array([[g.pin_radial_errors, g.pin_tangential_errors] for g in many])
    assert errors.std() == pytest.approx(10e-6, rel=4 / math.sqrt(2 * errors.size))
    assert abs(errors.mean()) < 4 * 10e-6 / math.sqrt(errors.size)
    assert abs(np.corrcoef(errors[:, 0].ravel(), errors[:, 1].ravel())[0, 1]) < 4 / math.sqrt(errors.size / 2)
    twice = gearbox_of(PinErrors(10e-6), many[0], seed=1)
    expected = errors[0, 0] + errors[1, 0]
    np.testing.assert_allclose(np.array(twice.pin_radial_errors), expected, rtol=1e-12, atol=1e-20)
    assert twice.replace(pin_radial_errors=(), pin_tangential_errors=()) == STEEL


def test_run_out_is_a_random_direction_of_given_length():
    found = np.array([gearbox_of(RunOut(7e-6), seed=seed).wheel_runouts for seed in range(300)])
    np.testing.assert_allclose(np.abs(found), 7e-6, rtol=1e-12)
    angles = np.angle(found) / (2 * np.pi) % 1
    for wheel in (0, 1):
        assert stats.kstest(angles[:, wheel], "uniform").pvalue > 1e-3
    assert stats.kstest(np.diff(angles)[:, 0] % 1, "uniform").pvalue > 1e-3
    there = STEEL.replace(wheel_runouts=(1e-6 + 0j, 2e-6j))
    np.testing.assert_allclose(gearbox_of(RunOut(7e-6), there).wheel_runouts, found[0] + [1e-6, 2e-6j])


def input_orders(gearbox, turns=15):
    """Amplitudes of the input torque at multiples of 1/15 of the input's speed, settled."""
    n = round(turns * 0.12 * 12_800)
    torque = simulate(gearbox, duration=0.5 + turns * 0.12, sampling_rate=12_800).torque_in[-n:]
    return 2 * np.abs(np.fft.rfft(torque)) / n


def test_run_out_shows_at_16_15_of_the_input_speed():
    """As its documentation says: against the load the wheel turns so, and not at the input's own speed."""
    gearbox = gearbox_of(RunOut(20e-6), STEEL.replace(wheel_runouts=()), seed=1)
    line, plain = input_orders(gearbox), input_orders(STEEL)
    assert line[16] > 20 * max(plain[16], line[15], 1e-5)


def test_cam_run_out_shows_once_per_input_turn():
    """With unequal pins; equal ones look alike from every angle."""
    unequal = STEEL.replace(pin_radial_errors=np.random.default_rng(4).normal(0, 1e-5, 16))
    for plain, shows in ((unequal, True), (STEEL, False)):
        gearbox = gearbox_of(CamRunOut(20e-6), plain, seed=1)
        np.testing.assert_allclose(np.abs(gearbox.cam_errors), 20e-6, rtol=1e-12)
        line = input_orders(gearbox)
        assert (line[15] > 1e-4) == shows
        assert max(line[14], line[16]) < 1e-5


def test_clearance_and_factors_are_exact():
    loose = STEEL.replace(clearance=5e-6)
    assert gearbox_of(Clearance(20e-6), loose) == STEEL.replace(clearance=5e-6 + 20e-6)
    assert gearbox_of(Scale("contact_stiffness", 1.5)) == STEEL.replace(stiffness_scale=0.01 * 1.5)
    assert gearbox_of(Scale("contact_damping", 0.5)) == STEEL.replace(contact_damping=75.0)
    assert gearbox_of(Scale("contact_damping", 0)) == STEEL.replace(contact_damping=0.0)


@pytest.mark.parametrize("load", [5.0, 22.0])
@pytest.mark.parametrize("n_pins", [14, 16])
def test_damping_of_the_other_form_is_matched_at_the_mean_load(load, n_pins):
    """Static balance of the pins solved for the twist; then equal power lost in a small vibration."""
    gearbox = STEEL.replace(load_torque=load, n_pins=n_pins)
    changed = gearbox_of(ContactDampingForm(factor=1.3), gearbox)
    arms = 2.8e-3 * (n_pins - 1) * np.sin(np.pi * (np.arange(n_pins // 2) + 0.5) / (n_pins // 2))
    contact = stiffness_factor(gearbox) * math.sqrt(6e-3)

    def forces(twist):
        return contact * (arms * twist) ** 1.5

    twist = brentq(lambda x: float(forces(x) @ arms) - load / 2, 0, 1e-2, xtol=1e-16)
    lost_before = gearbox.contact_damping * np.sum(arms**2)
    lost_after = changed.contact_damping * np.sum(forces(twist) * arms**2)
    assert lost_after == pytest.approx(1.3 * lost_before, rel=1e-9)
    assert changed.contact_law == "hunt_crossley"
    assert changed.replace(contact_law="paper", contact_damping=gearbox.contact_damping) == gearbox
    back = gearbox_of(ContactDampingForm("paper"), gearbox_of(ContactDampingForm(), gearbox))
    assert back.contact_law == "paper"
    assert back.contact_damping == pytest.approx(150, rel=1e-14)


def test_forms_that_cannot_be_matched_are_refused():
    with pytest.raises(ValueError, match="needs a load_torque above 0, got 0"):
        gearbox_of(ContactDampingForm(), STEEL.replace(load_torque=0.0))
    with pytest.raises(ValueError, match="contact_law in .* got 'conservative'"):
        gearbox_of(ContactDampingForm(), STEEL.replace(contact_law="conservative"))
    hunt = STEEL.replace(contact_law="hunt_crossley", contact_damping=0.5)
    assert gearbox_of(ContactDampingForm("hunt_crossley"), hunt) == hunt


def test_brake_rotor_is_with_brake():
    assert gearbox_of(BrakeRotor(0.03, 5e3, 0.04)) == STEEL.with_brake(0.03, 5e3, 0.04)
    with pytest.raises(ValueError, match="without a brake, got brake_inertia 0.02"):
        gearbox_of(BrakeRotor(), STEEL.with_brake(0.02, 1e4, 0.1))


# Load


def drift_values(effect, duration, rate, seed=5):
    """What an effect adds to load or torque."""
    n = round(duration * rate)
    if effect.overrides("load_fluctuation"):
        return effect.load_fluctuation(STEEL, duration, np.random.default_rng(seed))(np.arange(n) / rate)
    return torque_of(effect, np.full(n, 22.0), seed, rate) - 22.0


drifts = pytest.mark.parametrize("of", ["load", "sensor"])


@pytest.mark.slow
@drifts
@pytest.mark.parametrize("order", [1, 2, 3])
def test_spectrum_of_a_drift_is_that_of_its_low_pass(of, order):
    cutoff, rate, duration = 3.0, 256.0, 1600.0
    values = drift_values(Drift(1.7, cutoff, order, of), duration, rate)
    f, psd = signal.welch(values, rate, nperseg=4096, detrend=False)
    noise_bandwidth = cutoff * (np.pi / (2 * order)) / math.sin(np.pi / (2 * order))
    theory = 1.7**2 / noise_bandwidth / (1 + (f / cutoff) ** (2 * order))
    for low, high in ((0.3, 2), (2, 4), (6, 12), (16, 32)):
        band = (f >= low) & (f < high)
        assert psd[band].sum() == pytest.approx(theory[band].sum(), rel=0.1)
    # Mean square of Gaussian noise: relative std sqrt(2 * integral of rho^2 / T), below 1/cutoff here.
    assert np.mean(values**2) == pytest.approx(1.7**2, rel=4 * math.sqrt(2 / (cutoff * duration)))
    assert abs(values.mean()) < 4 * 1.7 / math.sqrt(cutoff * duration)


@drifts
def test_a_drift_falls_as_its_low_pass_far_above_its_cutoff(of):
    """A filter bent towards half its rate is 10 dB short there, among the lines that are compared."""
    cutoff, rate = 1.5, 1024.0
    values = drift_values(Drift(3.0, cutoff, 2, of), 600.0, rate)
    f, psd = signal.welch(values, rate, window="blackmanharris", nperseg=4096, detrend=False)
    theory = 3.0**2 / (cutoff * (np.pi / 4) / math.sin(np.pi / 4)) / (1 + (f / cutoff) ** 4)
    band = (f > 60 * cutoff) & (f < 100 * cutoff)
    assert 10 * math.log10(psd[band].sum() / theory[band].sum()) == pytest.approx(0, abs=1)


@pytest.mark.parametrize(
    "effect", [Drift(), Drift(of="sensor"), WarmUp(), WarmUp(of="sensor"), StickSlip(), Rattle()], ids=repr
)
def test_a_longer_run_begins_like_a_shorter_one(effect):
    short = drift_values(effect, 2.0, 500.0)
    np.testing.assert_array_equal(short, drift_values(effect, 20.0, 500.0)[:1000])
    same = isinstance(effect, WarmUp)
    assert np.array_equal(short, drift_values(effect, 2.0, 500.0, seed=6)) == same


def test_a_drift_in_proportion_keeps_the_mean_and_is_normal_in_its_logarithm():
    gearbox = CycloidalGearbox.steel(load_torque=17.0)
    time, n = np.linspace(0, 60, 60_001), 60 * 2 * 50  # independent values, about
    load, longer = (
        ProportionalDrift(0.2, 50.0).load_fluctuation(gearbox, end, np.random.default_rng(1))(time)
        for end in (60.0, 90.0)
    )
    logarithm = np.log1p(load / 17.0)
    assert logarithm.std() == pytest.approx(0.2, rel=4 / math.sqrt(2 * n))
    assert logarithm.mean() == pytest.approx(-0.02, abs=4 * 0.2 / math.sqrt(n))
    assert abs(stats.skew(logarithm)) < 4 * math.sqrt(6 / n)
    assert load.mean() == pytest.approx(0, abs=4 * 17 * 0.2 / math.sqrt(n))
    np.testing.assert_allclose(longer, load, rtol=1e-12, atol=1e-12)


# The torque meter


@pytest.mark.parametrize(("cutoff", "order"), [(300.0, 2), (1200.0, 4), (50.0, 1)])
def test_low_pass_has_the_response_of_a_butterworth(cutoff, order):
    """Waves of whole periods, measured after one second, against the analogue filter's closed form."""
    effect = TorqueMeterLowPass(cutoff, order)
    for frequency in (10.0, 40.0, cutoff, 800.0):
        given = wave(frequency)
        late = slice(round(FS), None)
        found = phasor(torque_of(effect, given)[late], frequency) / phasor(given[late], frequency)
        analogue = signal.butter(order, 2 * np.pi * cutoff, analog=True)
        _, expected = signal.freqs(*analogue, 2 * np.pi * frequency)
        # The bilinear transform moves frequencies by (pi f/fs)^2/3: below 2 % of the attenuation here.
        assert abs(found) == pytest.approx(abs(expected[0]), rel=0.02)
    at_cutoff = torque_of(effect, wave(cutoff))[round(FS) :]
    assert abs(phasor(at_cutoff, cutoff)) == pytest.approx(math.sqrt(0.5), rel=1e-6)


@pytest.mark.parametrize("cutoff", [3.0, 20.0, 300.0])
def test_low_pass_of_a_running_machine_begins_without_a_transient_of_the_mean(cutoff):
    """Against the same record that began long before: what is left of a ripple A at f is below A f_c/f."""
    n, before, amplitude, ripple = 25_600, 40_000, 3.0, 133.3
    phase = np.pi / 3 - 2 * np.pi * ripple * before / FS
    long = 22 + wave(ripple, n + before, amplitude, phase=phase)
    assert long[before] > 24  # where a start at the first value would show
    effect = TorqueMeterLowPass(cutoff)
    left = np.abs(torque_of(effect, long[before:]) - torque_of(effect, long)[before:])
    assert left.max() < amplitude * min(1.0, cutoff / ripple)
    assert left[round(2.5 / cutoff * FS) :].max() < 1e-3 * amplitude


def test_low_pass_of_short_and_constant_records():
    for n in (1, 2, 500):
        for cutoff in (0.1, 5.0):
            found = torque_of(TorqueMeterLowPass(cutoff), np.full(n, 22.0))
            # rounding of the coefficients: (fs / (2 pi f_c))^2 times that of a number
            rounding = 4 * np.finfo(float).eps * (FS / (2 * np.pi * cutoff)) ** 2
            np.testing.assert_allclose(found, np.full(n, 22.0), rtol=rounding)
    assert torque_of(TorqueMeterLowPass(5.0), np.zeros(0)).size == 0


def test_gain_offset_and_clipping_are_exact():
    torque = np.random.default_rng(0).normal(22, 3, 1000)
    np.testing.assert_array_equal(torque_of(Gain(1.03), torque), 1.03 * torque)
    np.testing.assert_array_equal(torque_of(Offset(-0.4), torque), torque - 0.4)
    for effect in (Clipping(22.5), Quantisation(0.0, 22.5)):
        np.testing.assert_array_equal(torque_of(effect, -torque), np.clip(-torque, -22.5, 22.5))


# Noise and hum


def test_white_noise_has_its_rms_and_no_colour():
    n = 200_000
    noise = torque_of(Noise(0.3), np.full(n, 22.0)) - 22
    assert noise.std() == pytest.approx(0.3, rel=4 / math.sqrt(2 * n))
    assert abs(noise.mean()) < 4 * 0.3 / math.sqrt(n)
    for lag in (1, 2, 7):
        assert abs(np.corrcoef(noise[lag:], noise[:-lag])[0, 1]) < 4 / math.sqrt(n)
    assert stats.kstest(noise[::20] / 0.3, "norm").pvalue > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0])
def test_coloured_noise_falls_as_its_power(exponent):
    rate = 2000.0
    noise = torque_of(Noise(0.3, exponent), np.zeros(2**20), 3, rate)
    f, psd = signal.welch(noise, rate, nperseg=16_384)
    bands = np.geomspace(2, 900, 8)
    levels = [np.log(psd[(f >= a) & (f < b)].mean()) for a, b in itertools.pairwise(bands)]
    theory = np.maximum(f, 1.0) ** -exponent
    expected = [np.log(theory[(f >= a) & (f < b)].mean()) for a, b in itertools.pairwise(bands)]
    np.testing.assert_allclose(np.diff(levels), np.diff(expected), atol=0.1)


def test_rms_of_coloured_noise_is_free_of_the_duration():
    runs = np.array([torque_of(Noise(0.3, 1.5), np.zeros(500), seed, 2000.0) for seed in range(300)])
    # 300 independent records of nearly one value each: relative std sqrt(2/300); 4 sigma
    assert np.mean(runs**2) == pytest.approx(0.09, rel=4 * math.sqrt(2 / 300))
    long = torque_of(Noise(0.3, 1.5), np.zeros(900), 7, 2000.0)
    np.testing.assert_allclose(long[:500], runs[7], atol=1e-12)


@pytest.mark.parametrize("phase", [0.0, 0.7])
def test_hum_has_the_amplitude_and_phase_given(phase):
    hum = torque_of(Hum(0.25, 50.0, (1, 0, 0.4), phase), np.full(51_200, 22.0)) - 22
    for k, share in ((1, 1.0), (2, 0.0), (3, 0.4)):
        # sin(x + p) is the cosine with phase p - pi/2
        expected = 0.25 * share * np.exp(1j * (k * phase - np.pi / 2))
        assert phasor(hum, 50.0 * k) == pytest.approx(expected, abs=1e-12)
    assert np.mean(hum**2) == pytest.approx(0.25**2 * (1 + 0.16) / 2, rel=1e-9)


def test_random_phases_of_hum_are_uniform_and_independent():
    runs = [torque_of(Hum(0.25, 50.0, (1, 0.5)), np.zeros(5120), seed) for seed in range(300)]
    shares = np.array([[np.angle(phasor(run, f)) / (2 * np.pi) % 1 for f in (50.0, 100.0)] for run in runs])
    assert stats.kstest(shares[:, 0], "uniform").pvalue > 1e-3
    assert stats.kstest((shares[:, 1] - 2 * shares[:, 0]) % 1, "uniform").pvalue > 1e-3
    np.testing.assert_allclose([abs(phasor(run, 50.0)) for run in runs], 0.25, rtol=1e-9)


# The converter


@pytest.mark.parametrize("relative", [3e-4, -3e-4, 0.02])
def test_clock_error_moves_a_line_by_exactly_its_factor(relative):
    for frequency in (133.3, 5000.0, 11_000.0):
        given = 22 + wave(frequency, 40_000)
        found = torque_of(ClockError(relative), given)
        instants = np.arange(found.size) / (1 + relative)
        exact = 22 + np.sin(2 * np.pi * frequency * instants / FS + 0.3)
        inner = slice(60, -60)
        assert np.abs(found - exact)[inner].max() < 2e-5
    assert torque_of(ClockError(relative), np.full(500, 22.0)) == pytest.approx(22.0, rel=1e-12)


@pytest.mark.parametrize("relative", [3e-4, -3e-4, 0.05, -0.05, 1e-9])
def test_clock_error_asks_for_the_samples_that_it_needs(relative):
    effect = ClockError(relative)
    for n in (2, 100, 46_080):
        needed = effect.samples_needed(n)
        out = torque_of(effect, np.zeros(needed))
        assert len(out) >= n
        # and no more than the width of its window beyond the last instant
        assert (needed - 1) - (n - 1) / (1 + relative) < 50
        assert effect.resample(np.zeros((needed, 3)), FS).shape == (len(out), 3)


def test_other_channels_follow_the_clock():
    angle = 4.0 + 0.002 * np.arange(1000)
    effect = ClockError(0.01)
    found = effect.resample(angle, FS)
    np.testing.assert_allclose(found, 4.0 + 0.002 * np.arange(found.size) / 1.01, rtol=1e-12)
    forces = np.abs(np.random.default_rng(0).normal(size=(1000, 2, 3)))
    assert effect.resample(forces, FS).min() >= 0


def test_quantisation_rounds_exactly():
    torque = np.random.default_rng(1).normal(22, 3, 20_000)
    found = torque_of(Quantisation(0.25), torque)  # a power of two: multiples are exact
    assert np.all(found * 4 == np.round(found * 4))
    assert np.abs(found - torque).max() <= 0.125
    halves = np.array([0.125, 0.375, 0.624, -0.125])
    np.testing.assert_array_equal(torque_of(Quantisation(0.25), halves), [0.0, 0.5, 0.5, -0.0])
    # what rounding adds: uniform over one step
    assert (found - torque).var() == pytest.approx(0.25**2 / 12, rel=0.03)


def test_quantisation_clips_at_its_range():
    ramp = np.linspace(-12, 12, 2401)
    assert np.unique(torque_of(Quantisation(1.0, 8.0), ramp)).tolist() == list(range(-8, 8))
    assert torque_of(Quantisation(0.1, 0.3), ramp).max() == pytest.approx(0.2)


def test_friction_and_pitch_errors_add_to_the_gearbox():
    rubbing = STEEL.replace(sleeve_friction=0.01, sleeve_static_friction=0.03, output_bearing_torque=0.1)
    found = gearbox_of(SleeveFriction(0.05, stribeck=0.02, viscous=3.0, journal=0.01), rubbing)
    assert (found.sleeve_friction, found.sleeve_static_friction) == (0.01 + 0.05, 0.03 + 0.05 + 0.02)
    assert (found.sleeve_viscous_friction, found.journal_friction) == (3.0, 0.01)
    found = gearbox_of(BearingFriction(0.2, viscous=0.05), rubbing)
    assert found == rubbing.replace(output_bearing_torque=0.1 + 0.2, output_bearing_viscosity=0.05)
    errors = np.array([gearbox_of(LobePitchErrors(5e-6), seed=seed).lobe_pitch_errors for seed in range(50)])
    assert errors.shape == (50, 30)
    assert errors.std() == pytest.approx(5e-6, rel=0.1)
    assert gearbox_of(LobePitchErrors(0.0)).lobe_pitch_errors == ()


# Shaft lines, warm-ups, stick-slip, rattle, clipping, lost samples


@pytest.mark.parametrize(("shaft", "per_input_turn"), [("input", 1.0), ("output", 1 / 15)])
def test_a_shaft_line_is_one_order_of_its_shaft_at_any_course_of_the_speed(shaft, per_input_turn):
    line = functools.partial(ShaftLine, 0.3, of=shaft)
    time = np.arange(60_000) / FS
    angle = 40 * time + 3 * np.sin(7 * time) + 0.4
    out = torque_of(line(phase=0.8), np.full(time.size, 22.0), input_angle=angle)
    np.testing.assert_allclose(out - 22, 0.3 * np.sin(per_input_turn * angle + 0.8), atol=1e-12)
    phases = [np.angle(phasor(torque_of(line(), 0 * time, k), 1.0)) for k in range(3)]
    assert len(set(np.round(phases, 6))) == 3
    with pytest.raises(ValueError, match=f"{shaft}_shaft_line needs gearbox and input_angle"):
        line().change_torque(time, FS, np.random.default_rng(0))
    with pytest.raises(ValueError, match=f"phase of {shaft}_shaft_line must be a number of rad"):
        line(phase=math.inf)._check()


def test_warm_ups_decay_with_their_time_constant_in_load_or_signal():
    load = WarmUp(2.0, 0.5).load_fluctuation(STEEL, 1.0, np.random.default_rng(0))
    np.testing.assert_allclose(load(np.array([0.0, 0.5, 1.0])), 2 * np.exp([0, -1, -2]), rtol=1e-12)
    out = torque_of(WarmUp(-3.0, 0.2, "sensor"), np.full(51_200, 22.0)) - 22
    assert out[0] == -3
    assert out[5120] == pytest.approx(-3 / math.e)
    with pytest.raises(ValueError, match="time must lie between 0 and 2 s"):
        load(np.array([3.0]))


def test_stick_slip_is_a_sawtooth_of_the_stated_rate_amplitude_and_no_mean():
    amplitude, frequency = 1.6, 4.0
    part = StickSlip(amplitude, frequency).load_fluctuation(STEEL, 100.0, np.random.default_rng(3))
    step = 1e-3
    load = part(np.arange(0, 100, step))
    slope = np.diff(load) / step
    sticking = slope > 0
    # Nine tenths of the time it rises at the rate A f.. / 0.9, over its whole length.
    assert np.mean(sticking) == pytest.approx(0.9, abs=0.01)
    assert np.median(slope[sticking]) == pytest.approx(amplitude * frequency / 0.9, rel=1e-6)
    slips = np.sum(sticking[:-1] & ~sticking[1:])
    assert slips == pytest.approx(100 * frequency, rel=0.02)
    tops = load[1:-1][sticking[:-1] & ~sticking[1:]]
    assert np.mean(tops) == pytest.approx(amplitude / 2, abs=0.03)
    assert tops.max() <= 0.75 * amplitude + 1e-9
    assert abs(load.mean()) < 0.03 * amplitude


def test_rattle_is_separate_blows_of_alternating_sign():
    rattle = Rattle(4.0, 20.0, blow_s=0.004)
    load = rattle.load_fluctuation(STEEL, 100.0, np.random.default_rng(5))(np.arange(0, 100, 1e-4))
    size = np.abs(load)
    peaks = load[1:-1][(size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:])]
    assert np.all(peaks[1:] * peaks[:-1] < 0)
    assert len(peaks) == pytest.approx(100 / (1 / 20 + 0.004), rel=0.06)
    assert np.mean(np.abs(peaks)) == pytest.approx(4.0, rel=0.1)
    # A triangle fills half of its base.
    assert np.mean(np.abs(load)) == pytest.approx(len(peaks) / 100 * 4.0 * 0.002, rel=0.1)


@pytest.mark.parametrize(("block", "share"), [(64, 0.03), (7.4, 0.2), (500, 0.01)])
def test_lost_samples_come_in_blocks_of_the_stated_length_and_share(block, share):
    torque = np.arange(1.0, 200_001)
    zero = torque_of(LostSamples(share, block, fill="zero"), torque, seed=4)
    lost = zero == 0
    assert lost.mean() == pytest.approx(share, rel=0.05)
    edges = np.diff(np.r_[0, lost.astype(int), 0])
    lengths = np.flatnonzero(edges == -1) - np.flatnonzero(edges == 1)
    whole = round(block)
    assert np.mean(lengths == whole) > 0.8  # neighbours may touch
    assert set(lengths[lengths > whole]) <= {2 * whole}
    np.testing.assert_array_equal(zero[~lost], torque[~lost])
    np.testing.assert_array_equal(torque_of(LostSamples(share, block, "cut"), torque, seed=4), torque[~lost])
    held = torque_of(LostSamples(share, block), torque, seed=4)
    before = np.flatnonzero(edges[:-1] == 1) - 1
    for k in before[before >= 0][:20]:
        assert set(held[k : k + whole + 1]) == {torque[k]}
    np.testing.assert_array_equal(held[~lost], torque[~lost])


@pytest.mark.parametrize("seed", range(20))
def test_enough_samples_stay_when_blocks_are_cut_out(seed):
    random = np.random.default_rng(seed)
    effect = LostSamples(random.uniform(0.001, 0.5), random.uniform(1, 3000), fill="cut")
    n = int(random.integers(1, 5000))
    assert len(torque_of(effect, np.zeros(effect.samples_needed(n)), seed)) >= n
