"""Counting rows of neighbouring worn lobes by a network."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp, softmax
from small_model import make_networks_small

from cyclofeat._base.training import first_weights
from cyclofeat.counting import LobeCounter, LobeModel, passage_of_lobe_zero
from cyclofeat.counting.estimators import _lobe_network
from cyclofeat.counting.model._training import draw_per_count
from cyclofeat.datasets import make_rig_recordings
from cyclofeat.models import load_model, save_model
from cyclofeat.recordings.windower import lobe_windower
from cyclofeat.simulators import Solver

COUNTS = (0, 1, 3, 5)


@pytest.fixture(scope="module", autouse=True)
def _small_networks():
    with pytest.MonkeyPatch.context() as patch:
        make_networks_small(patch)
        yield


def simulated(n: int, seed: int) -> list:
    return make_rig_recordings(
        n, COUNTS, rig="R1", speed_rpm=(400, 600), output_turns=1.05, sampling_rate=5120, random_state=seed,
        with_angle=True, kernel="auto", solver=Solver(integrator="adams_bashforth"),
    )  # fmt: skip


def windows_of(recordings):
    windows = lobe_windower(15).windows(recordings)
    return windows, windows.worn_table(15), passage_of_lobe_zero(windows.start_angle, 15)


@pytest.fixture(scope="module")
def training():
    return simulated(12, 0)


@pytest.fixture(scope="module")
def judged():
    return simulated(6, 1)


def network(**options):
    return LobeCounter(128.0, kind="network", input_speed_hz=1.0, **options)


@pytest.fixture(scope="module")
def fitted(training):
    """A counter, and what its networks said of the windows that they had not seen."""
    windows, worn, passage = windows_of(training)
    counter = network(speed_tolerance=0.0, random_state=0)
    return counter, counter._fit_cross_val_proba(windows.X, windows.y, windows.groups, worn, passage)


@pytest.fixture(scope="module")
def counter(fitted):
    return fitted[0]


@pytest.mark.slow
def test_counts_and_locates_assemblies_that_training_did_not_see(counter, judged):
    windows, worn, passage = windows_of(judged)
    right = counter.predict(windows.X) == windows.y
    assert right.mean() >= 0.9
    lobes = counter.predict_lobe_proba(windows.X, passage)
    assert np.mean((counter.predict_lobes(windows.X, passage) == worn)[right]) >= 0.98
    assert np.mean((lobes > 0.5)[right] == worn[right]) >= 0.98
    assert counter.calibrated_


@pytest.mark.slow
def test_windows_held_out_have_the_answer_of_the_network_that_did_not_see_them(fitted, training):
    windows = windows_of(training)[0]
    counter, held_out = fitted
    np.testing.assert_allclose(held_out.sum(axis=1), 1.0)
    assert np.mean(np.array(COUNTS)[held_out.argmax(axis=1)] == windows.y) >= 0.8
    assert np.abs(held_out - counter.predict_proba(windows.X)).max() > 0.01


@pytest.mark.slow
def test_a_network_answers_as_its_definition():
    """One window, one place and one layer after the other, in double precision; JAX answers as numpy."""
    random = np.random.default_rng(0)
    lines = (random.normal(size=(3, 9, 2)) @ [1, 1j]).astype(np.complex64)
    weights = {
        name: values + random.normal(scale=0.1, size=values.shape).astype(np.float32)
        for name, values in first_weights(_lobe_network.network_layers(2 * 7, 4), random).items()
    }
    turns = _lobe_network.place_turns(5, 9, 2)
    rows, sound = _lobe_network.log_odds(np, weights, lines, turns)
    of_jax = _lobe_network.log_odds(pytest.importorskip("jax").numpy, weights, lines, turns)
    np.testing.assert_allclose(of_jax[0], rows, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(of_jax[1], sound, rtol=1e-4, atol=1e-5)
    for one, (window, found) in enumerate(zip(lines.astype(complex), rows, strict=True)):
        used = {k: window[k - 1] for k in range(3, 10)}
        power = sum(abs(c) ** 2 for c in used.values())
        hidden = []
        for place in range(10):
            turned = [c * np.exp(2j * np.pi * k * place / 10) for k, c in used.items()]
            view = np.array([*np.real(turned), *np.imag(turned)]) * np.sqrt(14 / power)
            for name in ("hidden_1", "hidden_2"):
                view = np.maximum(weights[name].T @ view + weights[f"{name}_bias"], 0)
            expected = weights["row"].T @ view + weights["row_bias"]
            np.testing.assert_allclose(found[place], expected, rtol=1e-4, atol=1e-5)
            hidden.append(view)
        expected = weights["sound"][:, 0] @ np.mean(hidden, axis=0) + weights["sound_bias"][0]
        assert sound[one] == pytest.approx(expected, rel=1e-3, abs=1e-5)


def bumps(n: int, noise: float):
    """Rows of two lengths as bumps of the fold, at random places; a third of the windows has none."""
    random = np.random.default_rng(1)
    length, begins = random.integers(-1, 2, n), random.random(n)
    fold = (np.arange(240) / 240 - begins[:, np.newaxis]) % 1 * 5
    torque = (fold < length[:, np.newaxis] + 1) + noise * random.normal(size=fold.shape)
    return np.fft.rfft(torque, axis=1)[:, 1:13], length, begins


@pytest.fixture(scope="module")
def network_of_bumps():
    """A network that learned the first 200 rows."""
    return _lobe_network.train_network(
        *(values[:200] for values in bumps(300, 0.3)), n_lobes=5, n_lengths=2, n_epochs=60, random_state=0
    )


def answered(network, lines):
    """Log odds of rows at each place, and probabilities of no row and of either length."""
    turns = _lobe_network.place_turns(5, 12, 4)
    single = {name: values.astype(np.float32) for name, values in network.items()}
    rows, sound = _lobe_network.log_odds(np, single, lines.astype(np.complex64), turns)
    return rows, softmax(np.concatenate([sound[:, np.newaxis], logsumexp(rows, axis=1)], axis=1), axis=1)


@pytest.mark.slow
def test_a_network_learns_where_a_row_begins_and_how_long_it_is(network_of_bumps):
    lines, length, begins = bumps(300, 0.1)
    rows, proba = answered(network_of_bumps, lines[200:])
    assert np.mean(proba.argmax(axis=1) - 1 == length[200:]) >= 0.95
    worn = length[200:] >= 0
    found = rows.max(axis=2).argmax(axis=1) / rows.shape[1]
    beside = np.abs((found - begins[200:] + 0.5) % 1 - 0.5)[worn] * 5
    assert np.mean(beside <= 0.5) >= 0.9


@pytest.mark.slow
def test_impacts_at_the_lobe_rate_make_few_sure_answers(network_of_bumps):
    """A train of short impacts has equal lines whose phases are those of its place in the fold.

    Of the answers of a network that never saw any in training, 0.5 are wrong and sure.
    """
    lines, length, _ = bumps(300, 0.3)
    at = np.random.default_rng(2).random((100, 1))
    impacts = np.exp(-2j * np.pi * at * np.arange(1, 13)) * np.sqrt((np.abs(lines[200:]) ** 2).mean())
    _, proba = answered(network_of_bumps, lines[200:] + 1.5 * impacts)
    assert np.mean((proba.argmax(axis=1) - 1 != length[200:]) & (proba.max(axis=1) > 0.9)) < 0.35


@pytest.mark.slow
def test_turning_the_disc_by_a_lobe_turns_the_answer(counter, judged):
    """What is learned at one lobe holds for all: the passage only renumbers the lobes."""
    windows, _, passage = windows_of(judged)
    found = counter.lobe_map_.lines(windows.X)
    here, there = (counter._lobe_proba_of_lines(found, passage + turn) for turn in (0, 1 / 15))
    np.testing.assert_allclose(there, np.roll(here, -1, axis=1), atol=1e-4)


@pytest.mark.slow
def test_expected_count_is_the_sum_over_the_lobes(counter, judged):
    windows, _, passage = windows_of(judged)
    found = counter.lobe_map_.lines(windows.X)
    expected = counter._proba_of_lines(found) @ np.array(COUNTS)
    np.testing.assert_allclose(counter._lobe_proba_of_lines(found, passage).sum(axis=1), expected, atol=1e-6)


@pytest.mark.slow
def test_model_of_rows_counts_recordings_and_is_small_on_disk(training, judged, tmp_path):
    model = LobeModel(n_splits=0, counter="rows", epochs=150, random_state=0).fit(training)
    answers = model.count_all(judged)
    assert np.mean([a.defect_count == r.defect_count for a, r in zip(answers, judged, strict=True)]) >= 0.9
    assert [len(one.lobes) for one in answers] == [one.defect_count for one in answers]
    path = save_model(tmp_path / "rows.skops", model)
    assert path.stat().st_size < 2e6
    again = load_model(path).count_all(judged)
    assert [one.probability for one in again] == [one.probability for one in answers]
    n_learned = model.card_["n_windows"]
    whole = sum(len(model.windows(one)) for one in training)
    assert whole < n_learned <= whole + len(training) // 3, "of a third, windows by their lines too"
    assert model.counter_.n_epochs == 150


def test_rejects_lobes_that_are_no_row():
    X = np.random.default_rng(0).normal(size=(4, 2000))
    worn = np.zeros((4, 15), dtype=bool)
    worn[2:, [0, 4]] = True
    with pytest.raises(ValueError, match="use kind='trees' for other lobes"):
        network().fit(X, [0, 0, 2, 2], worn=worn, passage=np.zeros(4))
    with pytest.raises(ValueError, match="passage must be given"):
        network().fit(X, [0, 0, 2, 2], worn=worn)


def test_what_is_learned_without_its_tachometer_is_a_share_of_each_count():
    """Also where counts come in turn, and their number is a multiple of what the share leaves out."""
    recordings = [SimpleNamespace(defect_count=number % 3) for number in range(36)]
    some = draw_per_count(recordings, 1 / 3, 0)
    assert np.bincount([recordings[k].defect_count for k in some]).tolist() == [4, 4, 4]
    assert some == sorted({*some}) == draw_per_count(recordings, 1 / 3, 0)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (LobeModel(counter="lines"), "must be 'trees', 'rows' or a classifier of windows, got 'lines'"),
        (
            LobeModel(lobe_windower(samples_per_turn=256)),
            "at most 128 for counter='trees', which uses 44 lobe lines, got 256",
        ),
        (LobeModel(epochs=80), "epochs must be None unless counter='rows', got 80 with counter="),
    ],
)
def test_settings_that_exclude_each_other_are_refused(model, message):
    with pytest.raises(ValueError, match=message):
        model.fit([])
