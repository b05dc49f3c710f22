"""What the golden test compares, computed: the same for the script that records it and for the test."""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from cyclofeat import features
from cyclofeat.cli import main
from cyclofeat.simulators import (
    CycloidalGearbox,
    GearboxParameter,
    LobeDefects,
    Rig,
    Solver,
    load_campaign,
    simulate,
)

HERE = Path(__file__).parent
RATE = 2560.0
TURN = 4608  # samples of an output turn at 500 RPM
NM_PER_CODE = 2e-3
MODEL = HERE / "model.skops"
# The stored model is read by whatever versions are installed.
ALLOW = [
    word for name in ("cyclofeat", "scikit-learn", "python", "numpy", "scipy") for word in ("--allow", name)
]
# Recordings whose features are stored, and the two classes of those that learn from labels.
WITH_FEATURES = ("R1-0", "R1-3", "R1-7", "R2-0", "R2-5", "R2-7")
# A design of runs so short that they cost next to nothing once the machine has settled.
DESIGN = {
    "name": "golden", "defect_counts": [0, 3], "repeats": 16, "duration": 0.25, "sampling_rate": 2560.0,
    "depth": [0.3, 1.0], "runs_per_shard": 16, "random_state": 5,
    "rig": Rig.r2().with_effects(GearboxParameter("load_torque", (15.0, 25.0))).to_dict(),
}  # fmt: skip
FEW_TEXTS = 4  # values of a column of texts up to which they are compared


# Recordings: stored once, in codes of 2 mNm.


def recordings() -> list[dict[str, Any]]:
    """The stored recordings: their names, and the arrays of files that the command line reads."""
    with np.load(HERE / "recordings.npz") as stored:
        data = {key: stored[key] for key in stored.files}
    n_samples = data["codes"].shape[1]
    return [
        {
            "name": name, "torque": data["codes"][i] * NM_PER_CODE, "sampling_rate": RATE,
            "angle": data["first_angle"][i] + data["angle_per_sample"][i] * np.arange(n_samples),
            "angle_of": "input", "angle_is_absolute": True, "assembly": name,
            "defect_count": int(data["worn"][i].sum()),
            "worn_lobes_from_1": np.flatnonzero(data["worn"][i]) + 1, "speed_rpm": 500.0,
            "source": "surrogate",
        }
        for i, name in enumerate(data["name"].tolist())
    ]  # fmt: skip


def without_angle(recording: dict[str, Any], name: str, **changes: Any) -> dict[str, Any]:
    """The same as of a rig without a tachometer."""
    kept = {key: value for key, value in recording.items() if not key.startswith("angle")}
    return kept | {"name": name} | changes


def odd_recordings(made: dict[str, dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """What should be refused, warned of or not read at all."""
    worn, healthy = made["R1-3-0"], made["R1-0-0"]
    time = np.arange(2 * TURN) / RATE
    jumps = 22 + np.sign(np.sin(2 * np.pi * 500 / 60 * time + 0.1)) + 0.01 * np.sin(2 * np.pi * 311 * time)
    yield without_angle(healthy, "odd-jumps", torque=jumps)
    for name, speed in (("odd-slower", 0.9), ("odd-faster", 1.1)):
        at = speed * np.arange(int(2 * TURN / max(speed, 1.0)))
        yield without_angle(worn, name, torque=np.interp(at, np.arange(2 * TURN), worn["torque"]))
    half = {name: worn[name][: TURN // 2] for name in ("torque", "angle")}
    yield worn | {"name": "odd-short"} | half
    yield worn | {"name": "odd-rate", "sampling_rate": 2000.0}
    yield worn | {"name": "odd-label", "speed_rpm": 600.0}
    yield worn | {"name": "odd-angle", "angle": 0.9 * worn["angle"]}
    yield worn | {"name": "odd-lobes", "n_lobes": 13}
    yield without_angle(worn, "odd-gap", torque=np.where(np.arange(2 * TURN) == 5000, np.nan, worn["torque"]))
    yield worn | {"name": "odd-relative", "angle_is_absolute": False}


def write_files(folder: Path) -> dict[str, list[Path]]:
    """All recordings as files, by what they are good for."""
    made = {recording["name"]: recording for recording in recordings()}
    some = [recording for name, recording in made.items() if name.endswith("-1")]
    groups = {
        "with angle": list(made.values()),
        "without angle": [without_angle(one, f"{one['name']}-no-angle") for one in some],
        "odd": list(odd_recordings(made)),
    }
    files: dict[str, list[Path]] = {}
    for group, members in groups.items():
        files[group] = []
        for member in members:
            path = folder / f"{member['name']}.npz"
            np.savez(path, **{key: value for key, value in member.items() if key != "name"})
            files[group].append(path)
    return files


def command(*arguments: object) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of one call of the command line."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(argument) for argument in arguments])
    return code, out.getvalue(), err.getvalue()


def said(*arguments: object) -> str:
    """Standard output of a call that must succeed."""
    code, out, err = command(*arguments)
    assert code == 0, err
    return out


def counted(folder: Path) -> dict[str, Any]:
    """What ``cyclofeat count`` says of all files, of some without their first turn, and for people."""
    files = write_files(folder)
    every = [file for group in files.values() for file in group]
    skipped = files["with angle"][::9]
    told = [files["with angle"][0], files["with angle"][-1], files["odd"][0], files["odd"][3]]
    code, out, _ = command("count", *every, "--model", MODEL, *ALLOW, "--json")
    skip_code, skip_out, _ = command("count", *skipped, "--model", MODEL, *ALLOW, "--skip", 1.8, "--json")
    told_code, told_out, told_err = command("count", *told, "--model", MODEL, *ALLOW)

    def named(text: str) -> str:
        return text.replace(f"{folder}/", "").replace(f"{folder}\\", "")

    def by_name(text: str) -> dict[str, Any]:
        rows = json.loads(named(text))
        counted = [row for row in rows if "error" not in row]
        assert all(row.pop("model") == str(MODEL) for row in counted)  # a path of today
        for row in counted:  # those that are not refused are combined
            assert sum(not one["reason"] for one in row.pop("windows")) in (0, row["n_windows"])
        return {row.pop("file"): row for row in rows}

    return {
        "exit_codes": [code, skip_code, told_code],
        "counts": by_name(out),
        "without the first turn": by_name(skip_out),
        "for people": named(told_out + told_err).splitlines(),
    }


# Features.


def feature_values() -> dict[str, np.ndarray]:
    """Every transformer by the papers' preset on windows of one turn: values, and names as a second array."""
    kept = [one for one in recordings() if one["name"].rpartition("-")[0] in WITH_FEATURES]
    X = np.stack([one["torque"][:TURN] for one in kept])
    y = np.array([one["defect_count"] for one in kept])
    found = {}
    for name in features.__all__:
        transformer = getattr(features, name)(RATE)
        if hasattr(transformer, "preset"):
            transformer.set_params(preset="matlab_pwelch")
        values = transformer.fit(X[::2], y[::2]).transform(X[1::3])
        names = np.asarray(transformer.get_feature_names_out(), dtype=str)
        step = 8 if len(names) > 1000 else 1  # the window itself, or a whole spectrum
        found[name], found[f"{name}.names"] = values[:, ::step], names[::step]
    return found


# Simulation.


def machines() -> dict[str, tuple[CycloidalGearbox, LobeDefects, dict[str, Any]]]:
    """Gearboxes without anything drawn at random, their defects and options of the run."""
    steel, abs_ = CycloidalGearbox.steel(ramp_time=0.05), CycloidalGearbox.abs(ramp_time=0.05)
    k = np.arange(16)
    displaced = steel.replace(
        pin_radial_errors=tuple(4e-6 * np.sin(1.0 + 2.4 * k)),
        pin_tangential_errors=tuple(3e-6 * np.cos(0.3 + 1.7 * k)),
        wheel_runouts=(3e-6 + 1e-6j, -2e-6j),
        cam_errors=(2e-6j, 1e-6 + 0j),
    )
    rubbing = steel.replace(sleeve_friction=0.05, journal_friction=0.05, output_bearing_torque=0.3)
    return {
        "steel": (steel, LobeDefects.worn(3), {}),
        "abs": (abs_, LobeDefects.worn((0, 4), wheels=(0,), depth=0.7), {"start_angle": 2.0}),
        "brake": (steel.with_brake(0.02, 1e4, 0.02), LobeDefects.worn(5), {}),
        "displaced": (displaced, LobeDefects.healthy(), {}),
        "removed": (steel, LobeDefects.removed(1), {}),
        "hunt_crossley": (
            steel.replace(contact_law="hunt_crossley", contact_damping=1.0), LobeDefects.worn(1),
            {"solver": Solver(integrator="adams_bashforth")},
        ),
        "friction": (rubbing, LobeDefects.worn(2), {}),
    }  # fmt: skip


def simulated(step: int = 5) -> dict[str, np.ndarray]:
    """Torques of those machines over 0.15 s, every ``step``-th sample."""
    found = {}
    for name, (gearbox, defects, options) in machines().items():
        run = simulate(gearbox, defects, duration=0.15, **options)
        for kind in ("torque_out", "torque_in"):
            found[f"{name}.{kind}"] = getattr(run, kind)[::step]
    return found


# A campaign.


def campaign(folder: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What the command says of a small campaign, and the columns of its runs, torque's mean and std too."""
    (folder / "design.json").write_text(json.dumps(DESIGN), encoding="utf-8")
    out = folder / "out"
    text = said("campaign", folder / "design.json", "--out", out, "--jobs", 1, "--json")
    facts = {key: value for key, value in json.loads(text).items() if key not in ("folder", "bytes")}
    data = load_campaign(out)
    X = np.asarray(data.X, dtype=float)
    columns = {str(name): np.asarray(data.parameters[name]) for name in data.parameters}
    return facts, columns | {"torque's mean": X.mean(axis=1), "torque's std": X.std(axis=1)}


def described(values: np.ndarray) -> dict[str, Any]:
    """A column: how often each text occurs, or mean, deviation and range of its numbers."""
    if values.dtype.kind not in "biuf":
        found, numbers = np.unique([text_of(value) for value in values], return_counts=True)
        if len(found) > FEW_TEXTS:
            return {"texts": "many"}
        return {"texts": dict(zip(found.tolist(), numbers.tolist(), strict=True))}
    known = values[np.isfinite(values)].astype(float)
    of_known = {name: float(getattr(known, name)()) for name in ("mean", "std", "min", "max") if known.size}
    return {"n": known.size, **of_known}


def text_of(value: Any) -> str:
    return value if isinstance(value, str) else str(np.asarray(value).tolist())


# Training.


def trained(folder: Path) -> dict[str, Any]:
    """What ``train`` makes of the recordings of rig R2 and then counts on rig R1; what ``evaluate`` says."""
    files = write_files(folder)["with angle"]
    r1, r2 = ([file for file in files if file.name.startswith(rig)] for rig in ("R1", "R2"))
    model = folder / "trained.skops"
    card = json.loads(said("train", *r2, "--out", model, "--json"))
    rows = json.loads(said("count", *r1, "--model", model, "--json"))
    evaluated = json.loads(said("evaluate", *r2, "--folds", 4, "--jobs", 1, "--json"))
    kept = ("accuracy", "mean_absolute_error")
    return {
        "card": {key: card[key] for key in ("n_recordings", "n_windows", "classes", "calibrated")},
        "counts": {Path(row["file"]).name: row["probability"] for row in rows},
        "evaluated": {name: {key: one[key] for key in kept} for name, one in evaluated.items()},
    }
