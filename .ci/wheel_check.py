"""Use the installed wheel as a stranger would, in an environment that knows nothing of the checkout."""

import importlib.metadata
import json
import subprocess
import sys
import time
import traceback
from pathlib import Path


def command(*arguments: str) -> str:
    """Output of ``cyclofeat ARGUMENTS``; shows what went wrong if it fails."""
    result = subprocess.run([sys.executable, "-m", "cyclofeat", *arguments], capture_output=True, text=True)
    assert result.returncode == 0, f"cyclofeat {' '.join(arguments)}: {result.stdout}{result.stderr}"
    return result.stdout


def check_cold_import() -> None:
    code = "import time; before = time.perf_counter(); import cyclofeat; print(time.perf_counter() - before)"
    # The best of three: the first reads the files from disk and writes their byte code.
    seconds = min(float(subprocess.check_output([sys.executable, "-c", code])) for _ in range(3))
    print(f"cold import: {seconds:.3f} s")
    assert seconds < 1.5


def check_contents() -> None:
    import cyclofeat
    import cyclofeat.datasets
    import cyclofeat.simulators

    for module in (cyclofeat, cyclofeat.simulators, cyclofeat.datasets):
        assert Path(module.__file__).is_relative_to(sys.prefix), f"{module.__name__} is not the wheel's"
    assert importlib.metadata.version("cyclofeat") == cyclofeat.__version__

    files = importlib.metadata.files("cyclofeat")
    tops = {file.parts[0] for file in files if ".." not in file.parts}  # "..": the console script
    assert tops == {"cyclofeat", f"cyclofeat-{cyclofeat.__version__}.dist-info"}, tops
    assert any(file.name == "py.typed" for file in files)

    metadata = importlib.metadata.metadata("cyclofeat")
    licences = metadata["License-Expression"]
    assert licences == "BSD-3-Clause AND CC-BY-SA-4.0 AND MIT", licences
    texts = {file.parts[-2:] for file in files if "licenses" in file.parts}
    others = {("jelmerv_cycloidal", "LICENSE.md"), ("uplot", "LICENSE")}
    assert texts == {("licenses", "LICENSE"), *others}, texts


def check_data() -> None:
    from cyclofeat.datasets import load_oedi_gearbox, load_published_tables

    assert len(load_published_tables()) > 0
    try:
        load_oedi_gearbox()
    except FileNotFoundError as error:
        message = str(error)
    else:
        raise AssertionError("load_oedi_gearbox found recordings that the wheel does not hold")
    print(f"load_oedi_gearbox: {message}")
    for words in ("https://data.openei.org/submissions/623", "oedi_gearbox_mini_8192.npz", "path="):
        assert words in message, f"the message does not say where to get the recordings: {words}"


def check_simulation() -> None:
    from cyclofeat import Recording
    from cyclofeat.simulators import CycloidalGearbox, LobeDefects, simulate

    before = time.perf_counter()
    recording = Recording.from_run(simulate(CycloidalGearbox.steel(), LobeDefects.worn(1), duration=0.25))
    print(f"simulated 0.25 s in {time.perf_counter() - before:.1f} s, of which most compiles")
    assert recording.torque.size == round(0.25 * recording.sampling_rate)
    assert recording.defect_count == 1


def check_command_line() -> None:
    assert importlib.metadata.version("cyclofeat") in command("--version")
    text = command("--help")
    for name in ("simulate", "train", "count", "evaluate", "demo"):
        assert name in text, f"--help does not name {name}"


def check_counting() -> None:
    from cyclofeat import Recording
    from cyclofeat.datasets import write_recording
    from cyclofeat.simulators import CycloidalGearbox, LobeDefects, simulate

    # Long enough for the ramp at the start, which is skipped, and one turn of the output.
    write_recording(
        "worn.csv", Recording.from_run(simulate(CycloidalGearbox.steel(), LobeDefects.worn(3), duration=4.0))
    )
    before = time.perf_counter()
    command("train", "--assemblies", "5", "--out", "model.joblib")
    print(f"trained in {time.perf_counter() - before:.0f} s")
    (answer,) = json.loads(
        command("count", "worn.csv", "--model", "model.joblib", "--trust", "--skip", "0.5", "--json")
    )
    # What it counts, or refuses, is the tests' business: this gearbox stands on another rig than the model's.
    count = answer["refused_defect_count" if answer["refused"] else "defect_count"]
    assert isinstance(count, int)
    assert len(answer["lobe_probability"]) == 15
    print(f"counted {count} worn lobes")


def check_packaged_model() -> None:
    """The packaged model was written with one version of scikit-learn, and counts with others."""
    rig = ["--rig", "r2", "--worn-count", "3", "--duration", "4", "--seed", "1"]
    command("simulate", *rig, "--quantity", "input_torque", "--out", "disc.csv")
    (answer,) = json.loads(
        command("count", "disc.csv", "--quantity", "input_torque", "--speed", "500", "--json")
    )
    assert answer["defect_count"] == 3, answer
    assert answer["model"] == "packaged, input torque"
    print("counted 3 worn lobes with the packaged model")


def check_gap() -> None:
    """A missing effect is named, which takes much of numpy and scipy."""
    from cyclofeat.gap import load_posterior
    from cyclofeat.gap.measured import MeasuredRig
    from cyclofeat.recordings import Recording
    from cyclofeat.simulators import Hum, Noise, Rig

    rig = Rig(effects=[Hum(1.0), Noise(0.05)])
    runs = [rig.simulate(duration=2.0, random_state=seed) for seed in range(4)]
    recordings = [
        Recording(run.torque_out, 25_600, speed_rpm=500, load_nm=22, defect_count=0) for run in runs
    ]
    assert load_posterior().presence(MeasuredRig.of(recordings, Rig()).session())["hum"] > 0.5


failed = 0
for check in (
    check_cold_import,
    check_contents,
    check_data,
    check_simulation,
    check_command_line,
    check_counting,
    check_packaged_model,
    check_gap,
):
    try:
        check()
    except Exception:  # go on: one run shows all that is wrong
        failed += 1
        print(f"{check.__name__} FAILED")
        traceback.print_exc(file=sys.stdout)
    else:
        print(f"{check.__name__} passed")
sys.exit(failed > 0)
