"""The local page in a real browser: from a TDMS file to a count, by keyboard, narrow and dark."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from devtools import Browser, find_chromium
from live_server import Live, wait_for
from nptdms import ChannelObject, TdmsWriter
from small_model import RATE, recording, small_model

from cyclofeat.datasets import make_rig_recordings, write_recording
from cyclofeat.models import save_model
from cyclofeat.simulators import CycloidalGearbox, Hum, Noise, Rig

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(find_chromium() is None, reason="no Chromium: install Debian's package chromium"),
]

COMMANDS = (sys.executable, "-m", "cyclofeat")  # the real ones
STATUS = "document.getElementById('status').textContent"


def text_of(part):
    return f"document.getElementById('{part}').innerText"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A TDMS file with two channels, a CSV file with a hostile name, and a model."""
    folder = tmp_path_factory.mktemp("files")
    worn = recording((4, 5, 6), seed=100)
    wave = {"wf_increment": 1 / RATE, "wf_samples": worn.n_samples, "wf_start_offset": 0.0}
    with TdmsWriter(folder / "Prüfstand 7.tdms") as writer:
        writer.write_segment(
            [
                ChannelObject("rig", "left", worn.torque, wave | {"unit_string": "Nm"}),
                ChannelObject("rig", "right", np.ones(worn.n_samples), wave | {"unit_string": "Nm"}),
            ]
        )
    write_recording(folder / "healthy.csv", recording((), seed=101))
    (folder / "healthy.csv").rename(folder / "<img src=x onerror=alert(1)>.csv")
    save_model(folder / "model.skops", small_model())
    return folder


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile"), offline=False) as browser:
        yield browser


@pytest.fixture
def live(tmp_path):
    with Live(program=COMMANDS) as live:
        yield live


def open_page(browser, live, width=1200):
    browser.resize(width)
    browser.open("about:blank")  # the page before may have asked for its server, which is gone
    browser.said.clear()
    browser.open(live.address.url)
    browser.wait_for(STATUS, lambda text: "choose recordings" in text)


def tab_to(browser, name):
    """Reach an element as somebody without a mouse does."""
    for _ in range(60):
        browser.press("Tab")
        if browser.run("document.activeElement.id") == name:
            return
    raise AssertionError(f"{name} is not reached by the tab key")


def test_from_a_tdms_file_to_a_count_by_keyboard(browser, live, files):
    open_page(browser, live)
    for name in ("files", "folder", "example"):
        tab_to(browser, name)
    tab_to(browser, "other-model-summary")
    browser.press("Enter")
    tab_to(browser, "model-files")
    browser.choose(files / "model.skops", files / "model.skops.card.json")
    browser.wait_for(text_of("model"), lambda text: "counts 0 to 3 worn lobes" in text)
    tab_to(browser, "files")
    browser.choose(files / "Prüfstand 7.tdms")
    # two channels: the page says so in the words of the command, and offers both
    browser.wait_for(text_of("recordings"), lambda text: "several channels fit" in text, 120)
    tab_to(browser, "channel")
    browser.press("ArrowDown")
    browser.wait_for(text_of("recordings"), lambda text: "rig/left (Nm)" in text, 120)
    tab_to(browser, "count")
    browser.press("Enter")
    browser.wait_for(STATUS, lambda text: "Prüfstand 7.tdms: 3 worn lobes" in text, 120)
    assert browser.run("document.activeElement.id") == "count"  # the reader is not thrown elsewhere
    assert "3 worn lobes" in browser.run(text_of("jobs"))
    assert browser.run("document.getElementById('status').getAttribute('aria-live')") == "polite"
    page = browser.run("document.querySelector('#jobs a').href")
    browser.open(page)
    assert "3 worn lobes" in browser.run("document.body.innerText")
    assert browser.run("self.origin") == "null"  # a report is not the page's own
    assert browser.said == []


def test_recordings_are_compared_on_a_narrow_dark_screen(browser, live, files):
    browser.prefer("dark")
    live.session.given = ["--model", str(files / "model.skops")]
    open_page(browser, live, 400)
    hostile = files / "<img src=x onerror=alert(1)>.csv"
    browser.drop("#drop", files / "Prüfstand 7.tdms", hostile)
    browser.wait_for(text_of("recordings"), lambda text: "500 RPM" in text, 120)
    browser.click("count")
    # one has no channel of a usual name: the other is counted all the same
    browser.wait_for(STATUS, lambda text: "1 of 2 recordings counted" in text, 120)
    assert browser.run("document.querySelectorAll('img').length") == 0
    assert browser.run("document.documentElement.scrollWidth") <= 400
    # tables are blocks of lines here: no error and no note is cut off at the edge
    over = "[...document.querySelectorAll('.scroll')].map(one => one.scrollWidth - one.clientWidth)"
    assert browser.run(over) == [0, 0]
    head = "getComputedStyle(document.querySelector('#recordings td[data-head]'), '::before').content"
    assert "Channel" in browser.run(head)
    shade = "getComputedStyle(document.body).backgroundColor.match(/\\d+/g).slice(0, 3).map(Number)"
    assert max(browser.run(shade)) < 60
    browser.prefer("light")
    assert browser.said == []


def test_dropped_files_arrive_whole(browser, tmp_path):
    sent = {
        "a.csv": b"torque\n1\n2\n",
        "measured/recordings.csv": b"file\nb.npz\n",
        "measured/b.npz": bytes(range(256)),
    }
    (tmp_path / "measured" / "empty").mkdir(parents=True)
    for name, content in sent.items():
        (tmp_path / name).write_bytes(content)
    with Live() as live:
        open_page(browser, live)
        browser.drop("#drop", tmp_path / "a.csv", tmp_path / "measured")
        browser.wait_for(text_of("recordings"), lambda text: "measured (folder)" in text)
        # beside the frame, and without a place on the disk, as programs give what they hold in memory
        browser.run(
            "const data = new DataTransfer(); data.items.add(new File(['torque\\n3\\n'], 'memory.csv'));"
            "document.body.dispatchEvent(new DragEvent('drop', {dataTransfer: data, bubbles: true}))"
        )
        sent["memory.csv"] = b"torque\n3\n"
        browser.wait_for(text_of("recordings"), lambda text: "memory.csv" in text)
        kept = live.session.store.recordings
        assert {path.relative_to(kept).as_posix(): path.read_bytes() for path in kept.rglob("*.*")} == sent
        # what cannot be read is said
        browser.drop("#drop", tmp_path / "measured" / "empty")
        browser.wait_for(text_of("problem-simulate"), lambda text: "no files" in text)
    assert browser.said == []


@pytest.mark.slow
def test_a_gap_is_found_by_keyboard_and_its_report_downloaded(browser, live, tmp_path):
    gearbox = CycloidalGearbox.steel(input_speed=2 * np.pi * 690 / 60)
    measured = tmp_path / "measured"
    measured.mkdir()
    with_hum = make_rig_recordings(
        1, (0, 3), rig=Rig(gearbox, [Hum(0.5), Noise(0.05)]), duration=1.4, kernel="batch", random_state=0
    )
    for k, one in enumerate(with_hum):
        write_recording(measured / f"r{k}.npz", one)
    open_page(browser, live)
    tab_to(browser, "folder")
    browser.choose(measured)
    browser.wait_for(text_of("recordings"), lambda text: "r1.npz" in text and "690 RPM" in text, 120)
    tab_to(browser, "gap-summary")
    browser.press("Enter")
    tab_to(browser, "gap")
    browser.press("Enter")
    for stage in ("comparing measurement and model", "simulating the named effects, round 1"):
        browser.wait_for(STATUS, lambda text, stage=stage: stage in text, 300)
        assert stage in browser.run(text_of("jobs"))
    browser.wait_for(STATUS, lambda text: "Next:" in text, 300)
    found = browser.run(text_of("jobs"))
    assert "missing: hum (> 0.99): amplitude " in found
    browser.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    for name, part in (("gap.html", "Mains hum in the torque signal"), ("corrected.json", "hum")):
        tab_to(browser, f"download-2-{name}")  # 1: the inspection
        browser.press("Enter")
        arriving = tmp_path / name  # made empty, then filled
        wait_for(lambda file=arriving, part=part: file.exists() and part in file.read_text("utf-8"))
    browser.open(browser.run("document.querySelector('#jobs a').href"))
    assert "Mains hum in the torque signal" in browser.run("document.body.innerText")
    assert browser.said == []


def test_a_job_is_cancelled_and_a_lost_server_is_said(browser, tmp_path):
    with Live() as live:  # commands that stand in for the real ones
        open_page(browser, live)
        live.add("a.csv")
        number = live.start("gap", "a.csv", channel="wait")[1]["number"]
        browser.wait_for(text_of("jobs"), lambda text: "running" in text)
        browser.click(f"cancel-{number}")
        browser.wait_for(text_of("jobs"), lambda text: "cancelled" in text)
    browser.wait_for(STATUS, lambda text: "lost its connection to the server" in text)
    browser.said.clear()
