"""Every kind of page in a real browser: it opens without a word of complaint and without any network.

Marked ``browser``, not part of the plain tests: they need Chromium (Debian's package ``chromium``).
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from devtools import Browser, find_chromium
from gap_answers import answered
from pages import evaluated
from small_model import recording, small_model, unlike_training

from cyclofeat import Recording
from cyclofeat.report import (
    CountedRecording,
    Report,
    write_animation,
    write_count_report,
    write_evaluation_report,
    write_gap_report,
)
from cyclofeat.simulators import LobeDefects, simulate

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(find_chromium() is None, reason="no Chromium: install Debian's package chromium"),
]

HOSTILE = "<script>document.title = 'taken'</script>.npz"
SAYS = {
    "count": ["3 worn lobes", "Evidence", "Strength of the lobe lines", "What the words mean"],
    "several": ["2 of 4", "Could not be counted", "refused", HOSTILE, "not counted"],
    "evaluation": ["Accuracy", "Confusion", "Calibration", "How the folds were made"],
    "gap": ["2 effects are missing in the model", "cyclofeat train --rig", "Mains hum in the torque signal"],
    "recording": [HOSTILE, "clipped: 1 %", "bad span", "lost samples", "gaps, where samples"],
    "animation": ["The gearbox turning", "2 worn lobes: 1, 5", "Cam points at lobe", "SIMULATED:"],
}


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture(scope="module")
def run():
    return simulate(
        None, LobeDefects.worn((0, 4)), duration=0.5, sampling_rate=6400, forces=True, points=True
    )


@pytest.fixture(scope="module")
def pages(tmp_path_factory, compared_hum, run):
    folder = tmp_path_factory.mktemp("pages")
    model, worn = small_model(), recording((4, 5, 6), seed=100)
    given = {"worn.npz": worn, HOSTILE: recording((), seed=101), "strange.npz": unlike_training()}
    counted = [CountedRecording(name, one, model.count(one)) for name, one in given.items()]
    torque = worn.torque.copy()
    torque[400:600] = torque[400]
    spoiled = Recording.concatenate([worn.replace(torque=torque), worn]).with_bad_spans([(1, 1.5)])
    report = Report("Recordings").add_heading(HOSTILE).add_text("clipped: 1 %").add_figure(spoiled)
    gap, of_gap = answered(compared_hum["hum"]), {"sources": ["surrogate"], "settings": {"model": HOSTILE}}
    several = {"failures": {"bad.csv": "empty"}, "most_sections": 2}
    return {
        "count": write_count_report(model, counted[:1], folder / "count.html"),
        "several": write_count_report(model, counted, folder / "several.html", **several),
        "evaluation": write_evaluation_report({"bayes": evaluated(60)}, folder / "evaluation.html"),
        "gap": write_gap_report(gap, folder / "gap.html", **of_gap),
        "recording": report.write(folder / "recording.html"),
        "animation": write_animation(run, folder / "animation.html", part=(0.25, None), frames=61),
    }


@pytest.fixture
def opened(browser, pages):
    """Opens a page; at the end nothing may have been said, and nothing asked of a network."""
    browser.said.clear()
    browser.asked.clear()
    browser.prefer("light")
    browser.resize(1200)

    def open_page(name):
        browser.open(pages[name])
        return browser

    yield open_page
    assert browser.said == []
    assert {address.partition(":")[0] for address in browser.asked} <= {"file", "data"}


@pytest.mark.parametrize("name", SAYS)
def test_a_page_opens_quietly_and_says_what_it_must(opened, pages, name):
    browser = opened(name)
    text = browser.run("document.body.innerText.replace(/\\s+/g, ' ')")
    for part in SAYS[name]:
        assert part in text, part
    assert browser.run("document.title") != "taken"
    assert browser.run("Array.from(document.images).every(i => i.complete && i.naturalWidth > 0)")
    silent = "document.querySelectorAll('img:not([alt]), svg[role=img]:not([aria-label])').length"
    assert browser.run(silent) == 0
    assert pages[name].stat().st_size < 5e6


@pytest.mark.parametrize("name", SAYS)
def test_a_page_is_dark_on_dark_screens_and_light_on_paper(opened, browser, name):
    shade = "getComputedStyle(document.body).backgroundColor.match(/\\d+/g).slice(0, 3).map(Number)"
    seen = "Array.from(document.images).filter(i => i.offsetParent)"
    turned = f"{seen}.filter(i => getComputedStyle(i).filter !== 'none').length"
    drawn = f"{seen}.filter(i => i.className === 'drawing').length"
    browser = opened(name)
    assert min(browser.run(shade)) > 200
    assert browser.run(turned) == 0
    browser.prefer("dark")
    opened(name)
    assert max(browser.run(shade)) < 60
    assert browser.run(turned) == browser.run(drawn)
    paper = browser.print()
    assert paper.startswith(b"%PDF")
    assert len(re.findall(rb"/Type\s*/Page\b", paper)) >= 1
    # what a printer is given: the light scheme, whatever the screen prefers
    browser.call("Emulation.setEmulatedMedia", media="print")
    assert min(browser.run(shade)) > 200
    assert browser.run(turned) == 0
    browser.call("Emulation.setEmulatedMedia", media="")


@pytest.mark.parametrize("name", SAYS)
def test_a_page_fits_a_narrow_screen(opened, browser, name):
    browser.resize(400, 800)
    opened(name)
    assert browser.run("document.documentElement.scrollWidth") <= 400


# -- plots that can be zoomed


def said(browser, plot=0):
    return browser.run(f"document.querySelectorAll('.tools output')[{plot}].textContent")


def ends(browser, plot=0):
    """First and last time in view, as the read-out says them while nothing is pointed at."""
    return [float(number) for number in re.findall(r"[\d.]+(?= to| s)", said(browser, plot))]


def drag(browser, start, stop):
    left, top, width, height = browser.box(".u-over")

    def mouse(kind, share, **more):
        x, y = left + share * width, top + height / 2
        browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    mouse("mouseMoved", start)
    mouse("mousePressed", start, button="left", buttons=1, clickCount=1)
    mouse("mouseMoved", (start + stop) / 2, button="left", buttons=1)
    mouse("mouseMoved", stop, button="left", buttons=1)
    mouse("mouseReleased", stop, button="left", clickCount=1)
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=2, y=2)


def test_a_drag_zooms_and_a_double_click_shows_all_again(opened):
    browser = opened("count")
    assert ends(browser) == pytest.approx([0, 1.7995], abs=2e-3)
    drag(browser, 0.25, 0.5)
    assert ends(browser) == pytest.approx([0.45, 0.9], abs=0.02)
    browser.run("document.querySelector('.u-over').dispatchEvent(new MouseEvent('dblclick'))")
    assert ends(browser) == pytest.approx([0, 1.7995], abs=2e-3)


def test_the_keyboard_zooms_and_reads_the_recorded_values(opened):
    browser = opened("count")
    browser.run("document.querySelector('.zoom').focus()")
    for key in ("ArrowRight", "+", "+", "+", "+", "ArrowRight"):
        browser.press(key)
    time, torque = (float(part) for part in re.findall(r"(?:time|torque) ([\d.]+)", said(browser)))
    recorded = recording((4, 5, 6), seed=100).torque
    assert torque == pytest.approx(recorded[round(2000 * time)], rel=5e-4)
    assert "window 1: 3 worn lobes" in said(browser)
    browser.press("0")
    browser.run("document.querySelector('.tools button:last-of-type').click()")
    assert browser.run("document.querySelector('.tools output').getAttribute('aria-live')") == "polite"


def test_plots_of_the_gap_can_hide_a_curve(opened):
    browser = opened("gap")
    toggle = "document.querySelector('.live .legend button')"
    pressed = f"{toggle}.getAttribute('aria-pressed')"
    assert browser.run(pressed) == "true"
    assert browser.run(f"{toggle}.click(); {pressed}") == "false"
    browser.run("document.querySelector('.zoom').focus()")
    browser.press("ArrowRight")
    assert "model" not in said(browser).split("corrected")[0]


@pytest.mark.parametrize("name", ["count", "gap"])
def test_still_pictures_stay_without_scripts_and_on_paper(opened, browser, name):
    stills = "Array.from(document.querySelectorAll('.zoomable > img')).filter(i => i.offsetParent).length"
    live = "Array.from(document.querySelectorAll('.zoomable .live')).filter(i => i.offsetParent).length"
    opened(name)
    n = browser.run("document.querySelectorAll('.zoomable').length")
    assert (browser.run(stills), browser.run(live)) == (0, n)
    browser.call("Emulation.setEmulatedMedia", media="print")
    assert (browser.run(stills), browser.run(live)) == (n, 0)
    browser.call("Emulation.setEmulatedMedia", media="")
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        opened(name)
    finally:
        browser.call("Emulation.setScriptExecutionDisabled", value=False)
    assert (browser.run(stills), browser.run(live)) == (n, 0)


# -- the animation


PLAY = "document.getElementById('play').textContent"
TIME = "parseFloat(document.getElementById('now-time').textContent)"


def state(browser):
    found = browser.run(
        "({cursor: Number(document.querySelector('.cursor').getAttribute('x1')),"
        " wheel: document.querySelector('#wheel-0 g g').getAttribute('transform'),"
        " scrub: Number(document.getElementById('scrub').value)})"
    )
    now = {name: float(browser.text(f"now-{name}").split()[0]) for name in ("time", "turns", "lobe")}
    return found | now | {"button": browser.text("play")}


def scrub_to(browser, frame):
    slider = "document.getElementById('scrub')"
    browser.run(f"{slider}.value = {frame}; {slider}.dispatchEvent(new Event('input', {{bubbles: true}}))")


def test_it_turns_when_played_and_stands_when_stopped(opened):
    browser = opened("animation")
    before = state(browser)
    assert (before["time"], before["button"]) == (0, "Play")
    browser.click("play")
    browser.wait_for(TIME, lambda time: time > 0.002)
    browser.click("play")
    after = state(browser)
    assert after["button"] == "Play"
    assert after["wheel"] != before["wheel"]
    assert after["cursor"] > before["cursor"]
    assert state(browser) == after
    assert browser.text("said").startswith(f"{after['time']:.4f} s: output torque")


def test_it_can_be_scrubbed_to_any_frame(opened, run):
    browser = opened("animation")
    for frame in (60, 17, 0):
        scrub_to(browser, frame)
        found = state(browser)
        sample = round(np.linspace(0.25 * 6400, run.torque_out.size - 1, 61)[frame])
        phi = run.input_angle[sample]
        assert found["time"] == pytest.approx(frame / 60 * (0.25 - 1 / 6400), abs=1e-4)
        assert found["turns"] == pytest.approx((phi - run.input_angle[1600]) / (2 * np.pi), abs=1e-3)
        assert found["lobe"] - 1 == np.floor((16 * phi + np.pi) / (2 * np.pi) + 0.5) % 15


def test_arrows_point_to_where_the_simulated_sleeves_touch(opened, run):
    browser = opened("animation")
    frame = 23
    scrub_to(browser, frame)
    sample = round(np.linspace(0.25 * 6400, run.torque_out.size - 1, 61)[frame])
    tips = browser.run(
        "[0, 1].map(w => Array.from(document.querySelectorAll(`#wheel-${w} g.external path`))"
        ".map(p => (p.getAttribute('d').match(/^M(\\S+) (\\S+)L/) || []).slice(1).map(Number)))"
    )
    loaded = np.argwhere(run.external_forces[sample] > 25)
    assert loaded.size
    for wheel, pin in loaded:
        touching = 1e3 * run.external_points[sample, wheel, pin]
        assert abs(complex(*tips[wheel][pin]) - touching) < 0.3  # mm: forces are sent as whole N


def test_the_keyboard_is_enough(opened):
    browser = opened("animation")
    browser.press(" ")
    browser.wait_for(PLAY, lambda text: text == "Stop")
    browser.press(" ")
    browser.wait_for(PLAY, lambda text: text == "Play")
    scrub_to(browser, 30)
    browser.press("ArrowRight")
    assert state(browser)["scrub"] == 31
    browser.press("ArrowLeft")
    browser.press("ArrowLeft")
    assert state(browser)["scrub"] == 29
    # on the slider the keys are the slider's own
    browser.run("document.getElementById('scrub').focus()")
    browser.press("ArrowRight")
    assert state(browser)["scrub"] == 30
    browser.press("End")
    assert state(browser)["scrub"] == 60


def test_it_goes_on_from_the_start_after_the_end(opened):
    browser = opened("animation")
    scrub_to(browser, 60)
    browser.run("document.getElementById('speed').value = '0.05'")
    browser.click("play")
    browser.wait_for(TIME, lambda time: time < 0.2)
    browser.click("play")


def test_forces_can_be_hidden(opened):
    browser = opened("animation")
    shown = "Array.from(document.querySelectorAll('g.external')).map(g => getComputedStyle(g).display)"
    assert browser.run(shown) == ["inline", "inline"]
    browser.click("show-external")
    assert browser.run(shown) == ["none", "none"]


def test_a_page_that_complains_would_be_heard(browser, tmp_path):
    path = tmp_path / "bad.html"
    path.write_text(
        "<!DOCTYPE html><title>x</title><script>setTimeout(() => {throw Error('heard')});"
        "console.warn('this too'); fetch('http://example.org/').catch(() => 0)</script>",
        encoding="utf-8",
    )
    browser.open(path)
    browser.wait_for("1", lambda _: any("heard" in text for text in browser.said))
    assert any("this too" in text for text in browser.said)
    assert any(address.startswith("http://example.org") for address in browser.asked)
