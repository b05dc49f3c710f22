"""Write the golden data, or some of them, with the code as it is now.

    python tests/golden/record.py counts features     # from the repository root; no name: all parts
    python tests/golden/record.py --digests           # writes nothing: prints SHA-256 of everything computed

Run it only where the product is meant to say something else than before, and name only the parts that do:
``recordings`` and ``model`` are inputs of the others and change them.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2])]

import golden_cases as cases  # noqa: E402

from cyclofeat.counting import LobeModel  # noqa: E402
from cyclofeat.datasets import make_rig_recordings  # noqa: E402
from cyclofeat.models import save_model  # noqa: E402

PER_COUNT = {"R1": 8, "R2": 12}  # training assemblies of each count
N_TREES, N_LOCATOR_TREES = 40, 24  # few: the file shall be small


def surrogates(rig: str, n: int, seed: int) -> list[Any]:
    return make_rig_recordings(
        n, range(8), rig=rig, duration=2 * cases.TURN / cases.RATE, sampling_rate=cases.RATE,
        random_state=seed, with_angle=True,
    )  # fmt: skip


def record_recordings() -> None:
    made = [(rig, index, one) for rig in ("R1", "R2") for index, one in enumerate(surrogates(rig, 4, 90))]
    torque = np.stack([one.torque for *_, one in made])
    codes = np.round(torque / cases.NM_PER_CODE)
    if np.abs(codes).max() > np.iinfo(np.int16).max:
        raise ValueError("torque is larger than the codes reach")
    worn = np.zeros((len(made), 15), dtype=bool)
    for row, (*_, one) in zip(worn, made, strict=True):
        row[list(one.worn_lobes)] = True
    angle = np.stack([one.angle for *_, one in made])
    per_sample = (angle[:, -1] - angle[:, 0]) / (angle.shape[1] - 1)
    line = angle[:, :1] + per_sample[:, np.newaxis] * np.arange(angle.shape[1])
    if np.abs(line - angle).max() > 1e-9:
        raise ValueError("the input does not turn evenly")
    np.savez_compressed(
        cases.HERE / "recordings.npz",
        name=[f"{rig}-{one.defect_count}-{index // 8}" for rig, index, one in made],
        codes=codes.astype(np.int16),
        first_angle=angle[:, 0],
        angle_per_sample=per_sample,
        worn=worn,
    )


def record_model() -> None:
    made = [one for rig, n in PER_COUNT.items() for one in surrogates(rig, n, 91)]
    text = f"{len(made)} simulated assemblies of rigs R1 and R2"
    model = LobeModel(n_splits=0, n_trees=N_TREES, random_state=0, description=text)
    save_model(cases.MODEL, model.fit(made))


def record_simulation() -> None:
    torques = {name: values.astype(np.float32) for name, values in cases.simulated().items()}
    np.savez_compressed(cases.HERE / "simulation.npz", **torques)


def record_campaign() -> None:
    said, columns = _in_a_folder(cases.campaign)
    _write("campaign.json", {"said": said, "columns": {k: cases.described(v) for k, v in columns.items()}})


def _in_a_folder(compute: Callable[[Path], Any]) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        return compute(Path(folder))


def _write(name: str, value: Any) -> None:
    (cases.HERE / name).write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def print_digests() -> None:
    """SHA-256 of everything: equal only on one machine with the same libraries."""

    def show(name: str, data: bytes) -> None:
        print(f"{hashlib.sha256(data).hexdigest()}  {name}", flush=True)

    for name, values in cases.simulated(step=1).items():
        show(f"simulation: {name}", values.tobytes())
    for name, values in cases.feature_values().items():
        if not name.endswith(".names"):
            show(f"features: {name}", values.tobytes())
    for rig in ("R0", "R1", "R2", "published"):
        for one in surrogates(rig, 1, 92)[::3]:
            show(f"recordings: {one.assembly}", one.torque.tobytes())
    show("counts", json.dumps(_in_a_folder(cases.counted)).encode())
    with tempfile.TemporaryDirectory() as folder:
        _, columns = cases.campaign(Path(folder))
        for name, values in columns.items():
            show(f"campaign: {name}", "\n".join(map(cases.text_of, values)).encode())
        for path in sorted((Path(folder) / "out").iterdir()):
            show(f"campaign: {path.name}", path.read_bytes())


PARTS: dict[str, Callable[[], None]] = {
    "recordings": record_recordings,
    "model": record_model,
    "counts": lambda: _write("counts.json", _in_a_folder(cases.counted)),
    "features": lambda: np.savez_compressed(cases.HERE / "features.npz", **cases.feature_values()),
    "simulation": record_simulation,
    "campaign": record_campaign,
    "training": lambda: _write("training.json", _in_a_folder(cases.trained)),
}


def run() -> None:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("parts", nargs="*", help=f"of {', '.join(PARTS)}; default: all")
    parser.add_argument("--digests", action="store_true", help="print SHA-256 and write nothing")
    arguments = parser.parse_args()
    unknown = set(arguments.parts) - set(PARTS)
    if unknown:
        parser.error(f"unknown: {', '.join(sorted(unknown))}")
    if arguments.digests:
        print_digests()
        return
    for name in arguments.parts or PARTS:
        PARTS[name]()
        print(name, flush=True)


if __name__ == "__main__":
    run()
