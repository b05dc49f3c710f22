"""Every block of code in the README and the documentation runs, or at least is code of this toolkit.

Pages in ``RUN`` are executed from top to bottom in a folder that holds what they speak of: Python blocks in
one namespace, ``>>>`` blocks against what they print, commands through the command line's own entry point. A
block after a comment "not run: reason" is only parsed, as is every block of the other pages: its imports must
work, and its commands must be understood.
"""

from __future__ import annotations

import ast
import doctest
import importlib
import json
import os
import re
import runpy
import shlex
import shutil
import textwrap
import time
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, RootObject, TdmsWriter
from rooms import ROOT
from scipy.io import savemat

from cyclofeat.cli import main, make_parser
from cyclofeat.counting import LobeModel
from cyclofeat.datasets import write_recording
from cyclofeat.gap import World
from cyclofeat.models import save_model
from cyclofeat.simulators import known_effects

FOLDERS = (ROOT / "docs", ROOT / "docs" / "howto", ROOT / "docs" / "notes")
MADE = {"sg_execution_times.rst"}  # by "make docs"
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted(p for f in FOLDERS for p in f.iterdir() if p.suffix in (".md", ".rst") and p.name not in MADE),
]
# Others' pages, of which some blocks go on from data that only the text describes: parsed, not run.
PARSED = {"gap.md", "counting.md", "simulator.md", "api.rst"}
RUN = [path for path in PAGES[1:] if path.name not in PARSED and path.parent.name != "notes"]
# Commands that take minutes, on pages that go on from what others have made: parsed, not run.
LEFT_OUT = {"demo", "gap"}
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
FENCE = re.compile(r"^ *```(\w*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
DIRECTIVE = re.compile(r"^( *)\.\. code-block:: (\w+)\n((?:\1   .*\n| *\n)*)", re.MULTILINE)
NOT_RUN = re.compile(r"^(?:\.\.|<!--) not run: \S.*\n\s*\Z", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """One block of code of a page."""

    language: str
    text: str
    line: int
    runs: bool


def blocks(path: Path) -> list[Block]:
    text, found = path.read_text(encoding="utf-8") + "\n", []
    for match in (FENCE if path.suffix == ".md" else DIRECTIVE).finditer(text):
        *_, language, body = match.groups()
        language = {"": "console", "bash": "console", "sh": "console"}.get(language, language)
        body = textwrap.dedent(body).strip("\n") + "\n"
        runs = NOT_RUN.search(text, 0, match.start()) is None
        found.append(Block(language, body, text.count("\n", 0, match.start()) + 1, runs))
    return found


def commands(block: Block) -> list[tuple[list[str], str]]:
    """Commands of a block, with what is printed below each; comments behind them are left out."""
    found: list[tuple[list[str], list[str]]] = []
    prompt = any(line.startswith("$ ") for line in block.text.splitlines())
    for line in block.text.replace("\\\n", " ").splitlines():
        if prompt and not line.startswith("$ "):
            found[-1][1].append(line)
        elif line.strip():
            found.append((shlex.split(line.removeprefix("$ "), comments=True), []))
    return [(words, "\n".join(printed).strip()) for words, printed in found if words]


def test_every_page_is_looked_at():
    assert {"tutorial.rst", "campaigns.md", "nested.rst"} <= {path.name for path in RUN}
    assert sum(len(blocks(path)) for path in RUN) > 30
    workflow = blocks(ROOT / "docs" / "howto" / "gap.rst")
    assert [n for n, block in enumerate(workflow) if block.runs] == [5, 6]


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", PAGES, ids=named)
def test_blocks_are_code_of_this_toolkit(path):
    for block in blocks(path):
        where = f"{path.name}:{block.line}"
        if block.language == "python":
            for node in ast.walk(ast.parse(block.text, where)):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("cyclofeat"):
                    module = importlib.import_module(node.module)
                    missing = [alias.name for alias in node.names if not hasattr(module, alias.name)]
                    assert not missing, f"{where}: {node.module} has no {missing}"
        elif block.language == "console":
            for words, _ in commands(block):
                if words[0] == "cyclofeat":
                    try:
                        make_parser().parse_args(words[1:])
                    except ValueError as error:
                        pytest.fail(f"{where}: {' '.join(words)}: {error}")
        else:
            assert block.language in ("pycon", "json", "text", "matlab"), where


def test_the_cards_of_the_front_page_show_commands_that_are_understood():
    page = (ROOT / "docs" / "index.rst").read_text(encoding="utf-8")
    shown = [shlex.split(words) for words in re.findall(r"^ +``cyclofeat (.+)``$", page, flags=re.MULTILINE)]
    assert [command for command, *_ in shown] == ["count", "gap", "simulate"]
    for words in shown:
        make_parser().parse_args(words)


@pytest.fixture(scope="session")
def rig_files(tmp_path_factory, surrogates):
    """What the pages speak of: labelled recordings, and one of them from other programs' writers."""
    folder = tmp_path_factory.mktemp("rig")
    made = [recording for recording in surrogates if recording.defect_count != 5][:15]
    (folder / "measured").mkdir()
    rows = ["file,sampling_rate,defect_count,worn_lobes_from_1,assembly,speed,source"]
    for k, recording in enumerate(made):
        # float32 is what converters write; the labels come from the manifest, as with anybody's files.
        np.savez(
            folder / "measured" / f"r{k:02d}.npz",
            torque=recording.torque.astype(np.float32),
            sampling_rate=recording.sampling_rate,
            angle=recording.angle,
            angle_is_absolute=True,
        )
        worn = " ".join(str(lobe + 1) for lobe in recording.worn_lobes)
        rows.append(f"r{k:02d}.npz,25600,{recording.defect_count},{worn},A{k},500,surrogate")
    (folder / "measured" / "recordings.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    one = made[2]
    rate, degrees = one.sampling_rate, np.rad2deg(one.angle)
    wave = {"wf_increment": 1 / rate, "unit_string": "Nm"}
    volts = wave | {"unit_string": "V"}
    with TdmsWriter(folder / "rig.tdms") as writer:
        torque = ChannelObject("Messung", "Drehmoment", one.torque, wave)
        tacho = ChannelObject("Messung", "Tacho", 5.0 * (60 * one.angle / (2 * np.pi) % 1 < 0.5), volts)
        writer.write_segment([RootObject({}), torque, tacho])
    savemat(folder / "rig.mat", {"rig": {"torque": one.torque, "fs": rate}})
    with h5py.File(folder / "rig73.mat", "w", userblock_size=512) as file:
        for name, values in (("torque", one.torque[None]), ("fs", np.array([[rate]]))):
            file[name] = values
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with (folder / "rig73.mat").open("r+b") as file:  # the text before the HDF5 part
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    seconds = np.arange(one.n_samples) / rate
    frame = pd.DataFrame(
        {"Zeit [s]": seconds, "Drehmoment [Nm]": one.torque, "Motorstrom [A]": one.torque / 15}
    )
    frame.to_parquet(folder / "rig.parquet")
    frame.assign(Winkel=degrees).to_csv(folder / "rig.csv", index=False, sep=";", decimal=",")
    settled = time.time() - 60  # watch leaves files alone that are still being written
    (folder / "arriving").mkdir()
    write_recording(folder / "arriving" / "one.npz", one)
    os.utime(folder / "arriving" / "one.npz", (settled, settled))
    save_model(folder / "model.skops", LobeModel(n_splits=0, n_trees=30, random_state=0).fit(made))
    return folder


@pytest.fixture
def desk(rig_files, tmp_path, monkeypatch):
    """An own copy of the files, as working directory."""
    shutil.copytree(rig_files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run_commands(block: Block, page: str, capsys: pytest.CaptureFixture[str]) -> None:
    for words, expected in commands(block):
        if words[0] != "cyclofeat" or words[1] in LEFT_OUT:
            continue
        where = f"{page}:{block.line}: {' '.join(words)}"
        if words[1] == "watch" and "--once" not in words:
            words.append("--once")  # it would never end
        if words[1] == "campaign" and "--out" in words and "--jobs" not in words:
            words += ["--jobs", "1"]  # a few short runs are not worth starting processes for
        if words[1] == "train":
            for file in Path().glob("model.skops*"):  # the page makes its own, and a card
                file.unlink()
        capsys.readouterr()
        try:
            code = main(words[1:])
        except SystemExit as stop:
            code = stop.code
        out, err = capsys.readouterr()
        assert code == 0, f"{where}\n{err}"
        if expected:
            checker = doctest.OutputChecker()
            assert checker.check_output(expected + "\n", out, FLAGS), f"{where} prints\n{out}"
        if "--example" in words:  # of hundreds of runs: the first few, and short ones
            design = Path(words[words.index("--example") + 1])
            few = {"repeats": 1, "defect_counts": [0, 3], "duration": 0.05}
            design.write_text(
                json.dumps(json.loads(design.read_text(encoding="utf-8")) | few), encoding="utf-8"
            )


@pytest.mark.slow
@pytest.mark.parametrize("path", RUN, ids=named)
def test_page_runs_from_top_to_bottom(path, desk, capsys):
    space: dict[str, object] = {"__name__": path.stem}
    for block in blocks(path):
        where = f"{path.name}:{block.line}"
        if not block.runs:
            continue
        if block.language == "python":
            exec(compile(block.text, where, "exec"), space)
        elif block.language == "pycon":
            examples = doctest.DocTestParser().get_doctest(block.text, space, where, str(path), block.line)
            runner = doctest.DocTestRunner(optionflags=FLAGS, verbose=False)
            said: list[str] = []
            runner.run(examples, out=said.append, clear_globs=False)
            space |= examples.globs
            assert runner.failures == 0, "".join(said)
        elif block.language == "console":
            run_commands(block, path.name, capsys)


@pytest.mark.slow
def test_the_readme_is_followed_as_typed_in_an_empty_folder(tmp_path, monkeypatch, capsys):
    """Its commands take about seven minutes on two cores, as it states beside them."""
    monkeypatch.chdir(tmp_path)
    for block in blocks(ROOT / "README.md"):
        if block.language == "python":
            exec(compile(block.text, f"README.md:{block.line}", "exec"), {})
            continue
        for words, _ in commands(block):
            if words[0] == "cyclofeat":
                assert main(words[1:]) == 0, f"{words}\n{capsys.readouterr().err}"
    assert {"count.html", "gap.html", "corrected.json", "corrected.skops", "mine.json"} <= {
        path.name for path in tmp_path.iterdir()
    }


def test_every_command_of_the_readme_states_its_time():
    for block in blocks(ROOT / "README.md"):
        lines = block.text.splitlines() if block.language == "console" else []
        for line in lines:
            if line.startswith("cyclofeat "):
                assert re.search(r"# \d+ (s|min)\b", line), line


@pytest.mark.parametrize("page", ["README.md", "docs/results.md"])
def test_figures_are_those_of_the_benchmarks(page):
    """Each section's figures stand in the tables that it links."""
    text = (ROOT / page).read_text(encoding="utf-8")
    checked = 0
    for section in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        tables = re.findall(r"\]\((?:\.\./)?(benchmarks/[\w/]+\.md)\)", section)
        known = " ".join((ROOT / table).read_text(encoding="utf-8") for table in tables)
        figures = re.findall(r"\d+\.\d{2,}|\d+\.\d%|\d\d\.\d", section) if known else []
        missing = [one for one in figures if not re.search(rf"(?<![\d.]){re.escape(one)}(?!\d)", known)]
        assert not missing, f"{section.splitlines()[0]}: {missing}"
        checked += len(figures)
    assert checked > 10


def test_pages_of_effects_and_rigs_are_those_of_the_classes():
    """``python docs/_effects.py`` writes them."""
    made = runpy.run_path(str(ROOT / "docs" / "_effects.py"))
    for name in ("effects", "rigs"):
        assert (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8") == made[f"{name}_page"](), name


def test_every_effect_that_the_gap_weighs_has_its_row():
    text = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    weighed, *_ = text.partition("## Effects that")
    assert {f"| `{effect.effect_id}` |" for effect in World().effects} <= set(
        re.findall(r"\| `\w+` \|", weighed)
    )
    assert len(re.findall(r"^\| `", text, flags=re.MULTILINE)) == len(known_effects())
