"""The page of the gearbox turning: what is drawn is what was simulated."""

import base64
import dataclasses
import hashlib
import json
import re

import numpy as np
import pytest
from pages import assert_in_order, parse, summary_of, words

from cyclofeat.counting import passage_of_lobe_zero
from cyclofeat.report import write_animation
from cyclofeat.simulators import LobeDefects, simulate

WORN = (0, 4)


@pytest.fixture(scope="module")
def run():
    """The ramp, then two and a half input turns at full speed."""
    return simulate(None, LobeDefects.worn(WORN), duration=0.5, sampling_rate=6400, forces=True, points=True)


@pytest.fixture(scope="module")
def summary(run):
    return summary_of(write_animation, run, part=(0.25, None), frames=60)


@pytest.fixture(scope="module")
def machine(summary):
    return summary["machine"]


@pytest.fixture(scope="module")
def picked(run):
    """Samples of the frames."""
    return np.linspace(0.25 * 6400, run.torque_out.size - 1, 60).round().astype(int)


def distance_to(outline, point):
    """From a point to a closed polyline."""
    ahead = np.roll(outline, -1)
    edge = ahead - outline
    share = np.clip(((point - outline) * edge.conj()).real / np.abs(edge) ** 2, 0, 1)
    return np.abs(outline + share * edge - point).min()


def test_arrows_have_the_size_of_the_simulated_forces(run, machine, picked):
    for kind, n, forces in (("external", 16, run.external_forces), ("internal", 8, run.internal_forces)):
        drawn = np.abs(np.reshape(machine[kind], (60, 2, n, 2)) @ [1, 1j])
        np.testing.assert_allclose(drawn, forces[picked], atol=0.8)  # whole N along x and y


def test_arrows_end_where_sleeves_touch_the_drawn_wheels(run, machine, picked):
    z = machine["n_lobes"]
    points, forces = run.external_points[picked], run.external_forces[picked]
    apart = []
    for frame, phi in enumerate(machine["phi"]):
        for number, wheel in enumerate(machine["wheels"]):
            outline = np.reshape(wheel["outline"], (-1, 2)) @ [1, 1j]
            placed = wheel["cam"] * np.exp(1j * phi) + outline * np.exp(1j * (wheel["rest"] - phi / z))
            for pin in np.flatnonzero(forces[frame, number] > 20)[:3]:
                apart.append(distance_to(placed, 1e3 * points[frame, number, pin]))
    # In mm: what the contacts give way, most of all at the chord of a worn lobe.
    assert len(apart) > 100
    assert np.median(apart) < 0.01
    assert max(apart) < 0.4


def test_internal_sleeves_touch_their_holes(run, machine, picked):
    z, n = machine["n_lobes"], machine["n_sleeves"]
    at = 2j * np.pi * np.arange(n) / n
    for frame, phi in enumerate(machine["phi"]):
        for number, wheel in enumerate(machine["wheels"]):
            holes = wheel["cam"] * np.exp(1j * phi) + machine["sleeve_circle"] * np.exp(at - 1j * phi / z)
            touching = run.internal_forces[picked[frame], number] > 0
            points = 1e3 * run.internal_points[picked[frame], number]
            gap = np.abs(points - holes)[touching] - machine["hole_radius"]
            np.testing.assert_allclose(gap, 0, atol=0.2)  # mm that the loaded output lags behind


def test_the_shaded_times_are_the_passages_of_the_worn_lobes(run, machine):
    first = round(0.25 * 6400)
    passage = float(passage_of_lobe_zero(run.input_angle[first : first + 1])[0])
    turn = 15 / 16 * 2 * np.pi / run.gearbox.input_speed  # in which the cam passes all lobes once
    whole = [(begin + end) / 2 for begin, end in machine["bands"] if begin > 0 and end < 0.2499]
    expected = [turn * ((passage + lobe / 15) % 1 + k) for lobe in WORN for k in range(3)]
    assert len(whole) >= 3
    for middle in whole:
        assert min(abs(middle - moment) for moment in expected) < 3e-4


def test_colours_are_equal_steps_of_the_root_of_the_force(summary, machine):
    scale = machine["force_scale"]
    assert machine["largest_force"] <= 1.5 * scale
    below, *_, above = summary["steps"]
    assert float(below.split()[1]) == pytest.approx(scale / 25, rel=1e-2)
    assert float(above.split()[1]) == pytest.approx(scale * 16 / 25, rel=1e-2)


def test_the_trace_keeps_every_peak(run, machine):
    part = run.torque_out[round(0.25 * 6400) :]
    assert max(machine["trace"]) == pytest.approx(part.max(), abs=1e-3)
    assert min(machine["trace"]) == pytest.approx(part.min(), abs=1e-3)
    assert machine["duration"] == pytest.approx((part.size - 1) / 6400, abs=1e-6)


def test_the_page_is_whole_and_its_script_the_only_one_allowed(run, tmp_path):
    path = write_animation(run, tmp_path / "a.html", part=(0.25, None), frames=10, title="<b>Mine</b>")
    page = path.read_text(encoding="utf-8")
    parts = ["<b>Mine</b>", "SIMULATED:", "2 worn lobes: 1, 5, counted from 1.", "Play", "500 RPM"]
    assert_in_order(words(parse(page)), parts)
    data, script = re.findall(r"<script(?: [^>]*)?>(.*?)</script>", page, flags=re.DOTALL)
    json.loads(data)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in page
    assert "http" not in re.sub(r'http-equiv|"http://www.w3.org/2000/svg"', "", page)
    assert len(page) < 1e6


def test_removed_lobes_are_said_and_drawn(run):
    removed = dataclasses.replace(run, defects=LobeDefects.removed((2,), wheels=(1,)))
    found = summary_of(write_animation, removed, frames=2)
    assert found["worn"] == "removed lobes: 3; on wheel 2 only"
    front, back = found["machine"]["wheels"]
    assert front["removed"] == []
    assert back["removed"] == [2]
    radius = np.abs(np.reshape(back["outline"], (-1, 2)) @ [1, 1j]).reshape(15, -1)
    assert radius[2, 1:].max() < radius[3].min()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frames": 1}, "frames must lie between 2 and 5000, got 1"),
        ({"part": (0.4, 0.3)}, "part must lie in order"),
        ({"part": (0.0, 1.0)}, "within the run's 0.5 s"),
        ({"part": (0.2, 0.20001)}, "two samples at least"),
    ],
)
def test_animations_refuse(run, options, message):
    with pytest.raises(ValueError, match=message):
        summary_of(write_animation, run, **options)
    with pytest.raises(ValueError, match="forces=True, points=True"):
        summary_of(write_animation, dataclasses.replace(run, external_points=None))
