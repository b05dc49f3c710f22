"""The local page: who is refused, what uploads may do, and jobs that fail, hang and die."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from urllib.parse import quote

import numpy as np
import pytest
from command import start
from live_server import Live, wait_for
from small_model import recording, small_model

from cyclofeat.cli import main, make_parser
from cyclofeat.datasets import write_recording
from cyclofeat.datasets.readers import folder_entries
from cyclofeat.models import save_model
from cyclofeat.serve.store import Limits

HOSTILE = [
    "../../up.csv", "/etc/passwd", "..\\win.csv", "..", ".hidden.csv", "CON.csv", "-x.csv",
    "<script>alert(1)</script>.csv", "line\nbreak.csv", "x" * 900 + ".csv", "ü" * 300, "nul\0l.csv",
]  # fmt: skip


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    with Live() as live:
        yield live


@pytest.fixture
def fresh(tmp_path):
    """A server of its own, with narrow bounds."""
    limits = Limits(total_bytes=1000, files=3, jobs=2)
    with Live(limits=limits) as fresh:
        yield fresh


def files_below(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


# -- strangers


@pytest.mark.parametrize("key", ["", "wrong", "schlüssel"])
@pytest.mark.parametrize(("method", "path"), [("GET", ""), ("GET", "state"), ("POST", "files?name=a.csv")])
def test_without_the_key_nothing_is_served(live, key, method, path):
    assert live.address.listener.getsockname()[0] == "127.0.0.1"  # open for this machine only
    assert len(live.address.key) >= 32
    before = files_below(live.session.store.root)
    status, text, _ = live.ask(method, path, b"1" if method == "POST" else None, key=quote(key))
    assert status == 403
    assert "key" in text
    assert files_below(live.session.store.root) == before


def test_a_name_that_points_to_this_machine_is_refused(live):
    assert live.ask("GET", "state", Host="rebound.example")[0] == 400
    assert live.ask("GET", "state", Host="localhost:80")[0] == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "https://{own}"])
def test_other_origins_are_refused(live, origin):
    own = live.address.url.split("/")[2]
    asked = {"command": "simulate"}
    assert live.ask("POST", "jobs", asked, Origin=origin.format(own=own))[0] == 403
    assert live.session.jobs == {}
    # the page itself comes through, and is told what is wrong with its request
    assert live.ask("POST", "jobs", {"command": "x"}, Origin=f"http://{own}")[0] == 400


def test_pages_may_load_nothing_from_elsewhere_and_be_shown_nowhere_else(live):
    status, text, headers = live.ask("GET", "")
    assert status == 200
    policy = headers["content-security-policy"]
    for part in ("default-src 'none'", "script-src 'self'", "frame-ancestors 'none'", "form-action 'none'"):
        assert part in policy
    assert headers["referrer-policy"] == "no-referrer"
    assert headers["x-content-type-options"] == "nosniff"
    assert "https://" not in text.replace("http-equiv", "")
    assert "http://" not in text


# -- uploads


@pytest.mark.parametrize("name", HOSTILE)
def test_no_name_leads_out_of_the_folder(live, name):
    store = live.session.store
    before = files_below(store.root)
    status, answer = live.add(name)
    assert status == 200
    stored = answer["name"]
    assert sorted([*before, f"recordings/{stored}"]) == files_below(store.root)
    assert (store.recordings / stored).resolve().parent == store.recordings.resolve()
    assert not set(stored) & set("<>/\\\n\0")
    assert not stored.startswith(("-", "."))
    assert len(stored.encode()) < 200
    assert live.ask("DELETE", "recordings?name=" + quote(stored))[0] == 200
    assert files_below(store.root) == before


def test_a_name_that_is_taken_is_numbered_in_a_private_folder(live):
    names = [live.add("twice.csv.gz")[1]["name"] for _ in range(3)]
    assert names == ["twice.csv.gz", "twice (2).csv.gz", "twice (3).csv.gz"]
    assert os.name != "posix" or live.session.store.root.stat().st_mode & 0o077 == 0  # nobody else can read


def test_uploads_are_bounded_in_size_and_leave_room_again(fresh):
    assert fresh.add("a.csv", b"1" * 900)[0] == 200
    status, answer = fresh.add("b.csv", b"1" * 101)
    assert status == 413
    assert "remove some" in answer["error"]
    # without a stated length too
    assert fresh.ask("POST", "files?name=c.csv", (b"1" * 60 for _ in range(9)))[0] == 413
    assert files_below(fresh.session.store.root) == ["recordings/a.csv"]
    assert fresh.ask("DELETE", "recordings?name=a.csv")[0] == 200
    assert fresh.add("b.csv", b"1" * 1000)[0] == 200


def test_uploads_are_bounded_in_number(fresh):
    assert [fresh.add(f"{k}.csv", b"1")[0] for k in range(4)] == [200, 200, 200, 413]


def test_an_upload_that_breaks_off_leaves_nothing(fresh):
    host, port = fresh.address.listener.getsockname()
    with socket.create_connection((host, port)) as stream:
        head = f"POST /{fresh.address.key}/files?name=half.csv HTTP/1.1\r\nHost: {host}:{port}\r\n"
        stream.sendall(head.encode() + b"Content-Length: 900\r\n\r\n" + b"1" * 400)
        wait_for(lambda: files_below(fresh.session.store.root))
    wait_for(lambda: not files_below(fresh.session.store.root))
    assert fresh.add("whole.csv", b"1" * 1000)[0] == 200


def test_a_folder_keeps_the_names_that_its_manifest_states(live):
    (folder,) = live.ask("POST", "folders?name=measured", b"")[1].values()
    assert live.add("recordings.csv", b"file,speed\nr 1.csv,500\n", folder)[0] == 200
    assert live.add("r 1.csv", folder=folder) == (200, {"name": "r 1.csv"})
    status, answer = live.add("r 1.csv", folder=folder)
    assert status == 409
    assert "rename one" in answer["error"]
    assert live.start("inspect", folder)[0] == 200
    assert live.add("a.csv", folder="elsewhere")[0] == 404


@pytest.mark.parametrize("name", ["{outside}", "../{name}"])
def test_a_manifest_cannot_name_what_was_not_uploaded(live, tmp_path, name):
    outside = tmp_path / "secret.csv"
    outside.write_text("torque\n1\n2\n")
    (folder,) = live.ask("POST", "folders?name=trap", b"")[1].values()
    live.add("secret.csv")
    named = name.format(outside=outside, name="secret.csv")
    live.add("recordings.csv", f"file\n{named}\n".encode(), folder)
    status, answer = live.start("inspect", folder)
    assert status == 400
    assert "outside the folder" in answer["error"]


# -- models


def test_only_skops_models_are_taken(fresh):
    status, answer, _ = fresh.ask("POST", "others?name=m.joblib", b"pickle")
    assert status == 415
    assert "--trust" in answer["error"]
    assert fresh.ask("POST", "others?name=m.skops.card.json", b"{}")[0] == 409  # a card of nothing
    assert fresh.ask("POST", "others?name=m.skops", b"1" * 1001)[0] == 413
    assert fresh.session.store.others == {}


def test_a_chosen_model_is_counted_with_and_described_by_its_card(tmp_path):
    file = save_model(tmp_path / "m.skops", small_model())
    with Live(model=("--model", "given.skops", "--trust")) as live:
        live.add("a.csv")
        assert live.run("count", "a.csv").result[0]["words"][2:5] == [
            "--model", "given.skops", "--trust"
        ]  # fmt: skip
        live.ask("POST", "others?name=m.skops", file.read_bytes())
        assert "has no card" in live.ask("GET", "state")[1]["html"]["model"]
        live.ask("POST", "others?name=m.skops.card.json", (tmp_path / "m.skops.card.json").read_bytes())
        text = "counts 0 to 3 worn lobes in recordings at 500 RPM"
        assert text in live.ask("GET", "state")[1]["html"]["model"]
        words = live.run("count", "a.csv").result[0]["words"]
        assert words[2] == "--model"
        assert "given.skops" not in words
        assert "--trust" not in words  # said of the file given, not of one that was uploaded


# -- what may be asked


@pytest.mark.parametrize(
    ("asked", "status", "said"),
    [
        ({"command": "demo"}, 400, "command must be one of"),
        ({"command": ["count"]}, 400, "command must be one of"),
        ({"command": "inspect", "recordings": []}, 400, "at least one"),
        ({"command": "inspect", "recordings": ["/etc/passwd"]}, 404, "no such recording"),
        ({"command": "inspect", "recordings": [["a"]]}, 404, "no such recording"),
        ({"command": "inspect", "recordings": ["b.csv"], "options": {"effects_from": "x"}}, 400, "unknown"),
        ({"command": "inspect", "recordings": ["b.csv"], "options": {"speed": 5}}, 400, "printable"),
        ({"command": "inspect", "recordings": ["b.csv"], "options": {"channel": "a\0b"}}, 400, "printable"),
        ({"command": "inspect", "recordings": ["b.csv"], "options": [1]}, 400, "names with values"),
        ({"command": "gap", "recordings": ["b.csv"], "options": {"hold_out": "/etc"}}, 404, "no such"),
        ({"command": "gap", "recordings": ["b.csv"], "options": {"simulated": "/etc"}}, 404, "no such"),
    ],
)
def test_what_the_page_may_not_ask_is_refused(live, asked, status, said):
    if "b.csv" not in live.session.store.items:
        live.add("b.csv")
    before = len(live.session.jobs)
    answer = live.ask("POST", "jobs", asked)
    assert answer[0] == status
    assert said in answer[1]["error"]
    assert len(live.session.jobs) == before


def test_a_request_is_bounded_and_must_be_an_object(live):
    assert live.ask("POST", "jobs", b"[1]")[0] == 400
    assert live.ask("POST", "jobs", b"{" * 100_000)[0] == 400
    assert live.ask("POST", "jobs", b" " * 2**21)[0] == 413


def test_a_value_never_becomes_an_option(live):
    live.add("v.csv")
    words = live.run("inspect", "v.csv", speed="--trust", channel="--model=x y").result[0]["words"]
    assert words == ["inspect", "--json", "--speed=--trust", "--channel=--model=x y", "v.csv"]


def test_the_commands_understand_all_that_is_asked(live):
    """What the page spells is parsed by the real command line, with every option that the page has."""
    live.add("p.csv")
    reading = {
        "channel": "torque", "speed": "500", "sampling_rate": "25600", "scale": "2", "time_channel": "t",
        "angle_channel": "phi", "angle_unit": "deg", "n_lobes": "15", "delimiter": "tab",
        "angle_absolute": "yes",
    }  # fmt: skip
    live.session.given = ["--model", "m.skops"]
    asked = {
        "simulate": {}, "inspect": reading, "count": reading | {"skip": "0.5"},
        "gap": reading | {"hold_out": "0.4"},
    }  # fmt: skip

    def understood(command, **options):
        return make_parser([command]).parse_args(live.run(command, "p.csv", **options).result[0]["words"])

    named = {"speed": "speed_rpm", "hold_out": "by", "angle_absolute": "angle_is_absolute"}
    for command, options in asked.items():
        arguments = vars(understood(command, **options))
        assert arguments["json"] is True
        for name, value in options.items():
            typed = arguments[named.get(name, name)]
            assert typed in (value, True, float(value) if value[0].isdigit() else value), name
    assert understood("inspect", no_angle="yes").angle_channel is False
    arguments = understood("gap", simulated="p.csv")
    assert (arguments.simulated, arguments.save_simulator) == ("p.csv", None)
    live.session.given = []


def test_single_files_may_have_facts_of_their_own(live):
    """They reach the command in a manifest, over those stated of all files."""
    for name in ("own.csv", "other.csv"):
        live.add(name)
    facts = {"channel": "M, Nm", "quantity": "input_torque", "speed": "750"}
    assert live.ask("POST", "stated?name=own.csv", facts)[0] == 200
    assert live.ask("POST", "stated?name=own.csv", {"scale": "2"})[0] == 400
    assert live.ask("POST", "stated?name=none.csv", facts)[0] == 404
    job = live.run("count", "own.csv", "other.csv", speed="500", scale="2")
    words = job.result[0]["words"]
    assert words[-1] == "."
    assert "--scale=2" in words
    assert not [word for word in words if word.startswith(("--speed", "--channel"))]
    own, other = folder_entries(job.folder / "recordings")
    assert own.arguments == {"channel": "M, Nm", "quantity": "input_torque", "speed_rpm": 750.0}
    assert (other.path.name, other.arguments) == ("other.csv", {"speed_rpm": 500.0})
    assert live.ask("POST", "stated?name=own.csv", facts | {"speed": "fast"})[0] == 200
    assert "speed of own.csv must be a positive" in live.start("count", "own.csv")[1]["error"]
    assert live.ask("POST", "stated?name=own.csv", dict.fromkeys(facts, ""))[0] == 200
    words = live.run("inspect", "own.csv", speed="500").result[0]["words"]
    assert words[-2:] == ["--speed=500", "own.csv"]
    for name in ("own.csv", "other.csv"):
        live.session.store.remove_recording(name)


def test_a_gap_takes_an_uploaded_rig_and_posterior(live):
    live.add("g.csv")
    for name in ("mine.json", "mine.npz"):
        assert live.ask("POST", f"others?name={name}", b"{}")[0] == 200
    assert live.ask("POST", "others?name=mine.py", b"")[0] == 415
    words = live.run("gap", "g.csv").result[0]["words"]
    arguments = make_parser(["gap"]).parse_args(words)
    assert arguments.simulator.endswith("mine.json")
    assert arguments.posterior.endswith("mine.npz")
    assert "mine.json and mine.npz" in live.ask("GET", "state")[1]["html"]["gap_files"]
    live.session.store.others.clear()


def test_results_are_cleared_but_what_was_found_in_files_stays(live):
    live.add("c.csv")
    kept, gone = (live.run(command, "c.csv").number for command in ("inspect", "count"))
    assert live.ask("DELETE", "jobs")[0] == 200
    assert kept in live.session.jobs
    assert gone not in live.session.jobs


# -- jobs


def process_of(job):
    wait_for(lambda: job.messages)
    return int(job.messages[0].removeprefix("process "))


def runs(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.parametrize("manner", ["wait", "deaf"])
def test_a_job_can_be_cancelled_even_if_it_does_not_listen(live, manner):
    live.add("j.csv")
    number = live.start("inspect", "j.csv", channel=manner)[1]["number"]
    job = live.session.find_job(number)
    process = process_of(job)
    assert live.ask("GET", "state")[1]["busy"]
    assert live.ask("POST", f"jobs/{number}/cancel", b"")[0] == 200
    assert job.state == "cancelled"
    assert not runs(process)
    assert live.ask("POST", f"jobs/{number}/cancel", b"")[0] == 200  # twice does no harm
    assert live.ask("POST", "jobs/999/cancel", b"")[0] == 404


@pytest.mark.parametrize(
    ("manner", "state", "error"),
    [
        ("killed", "ended unexpectedly", "SIGKILL"),
        ("crash", "ended unexpectedly", "code 1: RuntimeError: a defect"),
        ("long", "ended unexpectedly", "cannot be run"),
        ("fail", "failed", "a.csv is empty"),
        ("usage", "failed", "bad --speed"),
    ],
)
def test_a_job_that_dies_or_fails_is_said_to_and_the_page_lives(live, manner, state, error):
    live.add("d.csv")
    live.session.given = ["--model", "m.skops"]
    job = live.run("count", "d.csv", channel=manner)
    live.session.given = []
    assert job.state == state
    assert error in job.error
    told = live.ask("GET", "state")[1]
    assert error in told["status"]
    assert error in told["html"]["jobs"]


def test_few_jobs_run_at_a_time_and_none_survives_the_server(tmp_path):
    with Live(limits=Limits(jobs=2)) as live:
        live.add("j.csv")
        numbers = [live.start("inspect", "j.csv", channel="wait")[1]["number"] for _ in range(2)]
        status, answer = live.start("inspect", "j.csv")
        assert status == 429
        assert "cancel one" in answer["error"]
        processes = [process_of(live.session.find_job(number)) for number in numbers]
        root = live.session.store.root
        assert root.exists()
    assert not any(map(runs, processes))
    assert not root.exists()


def test_a_program_that_cannot_be_started_is_an_answer(tmp_path):
    with Live(program=(str(tmp_path / "absent"),)) as live:
        live.add("j.csv")
        assert "cannot be run" in live.run("inspect", "j.csv").error


def test_only_what_a_job_wrote_for_the_page_is_served(live):
    live.add("o.csv")
    job = live.run("gap", "o.csv")
    number = job.number
    (job.folder / "secret.txt").write_text("not for you")
    status, text, headers = live.ask("GET", f"jobs/{number}/gap.html")
    assert (status, text) == (200, '"written"')
    # a report runs its scripts as nobody: it can ask this server for nothing
    assert "sandbox allow-scripts" in headers["content-security-policy"]
    assert "allow-same-origin" not in headers["content-security-policy"]
    headers = live.ask("GET", f"jobs/{number}/corrected.json?download")[2]
    assert headers["content-disposition"] == 'attachment; filename="corrected.json"'
    for path in (f"jobs/{number}/secret.txt", f"jobs/{number}/..%2f..%2fo.csv", "jobs/999/gap.html"):
        assert live.ask("GET", path)[0] == 404


# -- what is shown


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """What the real commands print of two recordings, one of them bad, by the name of the command."""
    folder = tmp_path_factory.mktemp("real")
    model = save_model(folder / "m.skops", small_model())
    write_recording(folder / "worn.csv", recording((4, 5, 6), seed=100))
    np.savetxt(folder / "two.csv", np.ones((5, 2)), delimiter=",", header="left,right", comments="")
    documents = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for command, options in (("inspect", []), ("count", ["--model", str(model)])):
            with open("printed.txt", "w", encoding="utf-8") as file:
                patch.setattr(sys, "stdout", file)
                assert main([command, "--json", "worn.csv", "two.csv", *options]) == 2
            documents[command] = (folder / "printed.txt").read_text()
    return documents


def test_the_page_shows_what_the_commands_print(printed, tmp_path):
    with Live(model=("--model", "m.skops")) as live:
        live.add("worn.csv")
        live.add("two.csv")
        state = live.ask("GET", "state")[1]
        assert state["uninspected"] == ["worn.csv", "two.csv"]
        for command in ("inspect", "count"):
            (live.session.store.recordings / "printed.json").write_text(printed[command])
            assert live.run(command, "worn.csv", "two.csv").state == "done"
        state = live.ask("GET", "state")[1]
    assert state["uninspected"] == []
    for part in ("torque (Nm)", "2000 Hz", "500 RPM", "which column is the torque"):
        assert part in state["html"]["recordings"]
    assert [f'value="{name}"' in state["html"]["channel"] for name in ("left", "right")] == [True, True]
    for part in (
        "3 worn lobes",
        '<td data-head="Positions">5, 6, 7</td>',
        "two.csv: --channel must be given",
    ):
        assert part in state["html"]["jobs"]
    assert state["status"].startswith("1 of 2 recordings counted")


def test_what_files_say_is_text_and_never_html(live):
    attack = "<img src=x onerror=alert(1)>"
    live.add("h.csv")
    row = {"file": "h.csv", "error": attack, "channels": {attack: attack}}
    file = live.session.store.recordings / "printed.json"
    file.write_text(json.dumps([row]))
    live.session.given = ["--model", attack]
    live.run("inspect", "h.csv")
    live.run("count", "h.csv")
    html = live.ask("GET", "state")[1]["html"]
    live.session.given = []
    file.unlink()
    assert "<img" not in "".join(html.values())
    for part in ("model", "channel", "recordings", "jobs"):
        assert "&lt;img" in html[part], part


def test_the_page_says_what_to_do_next(tmp_path):
    with Live() as live:

        def following():
            return live.ask("GET", "state")[1]["status"].partition("Next: ")[2]

        assert following().startswith("choose recordings")
        live.add("a.csv")
        assert following().startswith("check what was found")
        live.run("inspect", "a.csv")
        assert following().startswith("state what a.csv lacks")
        found = {
            "file": "a.csv", "channel": "a", "unit": "Nm", "sampling_rate": 9, "duration_s": 1,
            "output_turns": None, "speed_rpm": None, "speed_measured_rpm": None, "warnings": [],
        }  # fmt: skip
        (live.session.store.recordings / "printed.json").write_text(json.dumps([found]))
        live.run("inspect", "a.csv")
        assert following().startswith("state the speed")
        (live.session.store.recordings / "printed.json").unlink()
        live.run("count", "a.csv")
        assert following().startswith("open the page of the result")


# -- the command


def test_a_taken_port_and_a_wrong_one_are_errors_of_one_line(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["serve", "--no-browser", "--port", str(port)]) == 2
    assert f"port {port} is taken, perhaps by another cyclofeat serve" in capsys.readouterr().err
    assert main(["serve", "--no-browser", "--port", "65536"]) == 2
    assert "--port: must be a whole number from 0 to 65535, got '65536'" in capsys.readouterr().err
    assert main(["serve", "--no-browser", "--port", "0", "--model", "absent.skops"]) == 2
    assert "absent.skops does not exist" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends signals")
def test_ctrl_c_ends_quietly_and_deletes_the_uploads(tmp_path):
    command = [sys.executable, "-m", "cyclofeat", "serve", "--no-browser", "--port", "0", "--json"]
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    server = start(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    url = json.loads(server.stdout.readline())["url"]
    assert url.startswith("http://127.0.0.1:")
    wait_for(lambda: list(tmp_path.iterdir()), 60)
    time.sleep(0.2)
    server.send_signal(signal.SIGINT)
    out, err = server.communicate(timeout=60)
    assert (server.returncode, out) == (130, "")  # as every command ends by Ctrl-C
    assert err.splitlines()[-1] == "cyclofeat: stopped"
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []
