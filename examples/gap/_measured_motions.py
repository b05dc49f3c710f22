"""Measurements of others whose known effects simple simulators lack: fetched once, from pinned addresses."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from urllib.request import urlopen

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from sklearn.datasets import get_data_home

from cyclofeat._base.files import write_whole
from cyclofeat.gap.posterior.answers import ABSENT, NAMED, PRESENT

Recording = dict[str, NDArray[np.float32]]
GITHUB = "https://raw.githubusercontent.com"


def load_servo_pendulum(folder: Path | None = None) -> list[Recording]:
    """Load sixteen recordings of a servo (Dynamixel XL330) that swings 0.49 kg at 0.1 m, at 7.4 V.

    Each has `timestamp` in s, `goal_position` and `position` in rad, `speed` in rad/s and `torque_enable`;
    four have the gain 100, four 200, four 400 and four 800. From the public repository Rhoban/bam
    (Apache-2.0). They lie in `folder`, by default scikit-learn's data folder, or are written there.
    """
    commit = "af2260462471ff45ac18af159b1327ea51d8db15"
    minutes = {28: (10, 17, 24, 32, 42, 49, 57), 29: (4, 14, 21, 29, 37, 47, 54), 30: (2, 10)}
    names = [f"2026-01-15_10h{m}m{s:02d}" for m, seconds in minutes.items() for s in seconds]
    keys = ("timestamp", "goal_position", "position", "speed", "torque_enable")

    def parse(text: bytes) -> Recording:
        entries = json.loads(text)["entries"]
        return {key: np.array([entry[key] for entry in entries], np.float32) for key in keys}

    addresses = {n: f"{GITHUB}/Rhoban/bam/{commit}/bam/data.bak/processed/{n}.json" for n in names}
    checksum = "994456d273997824c3d2dd8af6d41e4be779ab659a4326d346c0062f1798437c"
    return fetch_recordings("bam_xl330.npz", folder, addresses, keys, parse, checksum)


def load_double_pendulum(folder: Path | None = None) -> list[Recording]:
    """Load eight recordings of a double pendulum with two quasi-direct drives (design C.1).

    Each has `time` in s and, for joint 1 (shoulder) and 2 (elbow), the angle `pos_meas` in rad, commanded and
    measured torque `tau_con` and `tau_meas` in Nm. From the public repository
    dfki-ric-underactuated-lab/double_pendulum (BSD-3-Clause). See :func:`load_servo_pendulum` for `folder`.
    """
    source = "dfki-ric-underactuated-lab/double_pendulum/2b055e76caac222322a30384ce61024e0743d0ca"
    place = f"{GITHUB}/{source}/data/experiment_records/design_C.1/sys_id/20230629"
    times = (143339, 143524, 143601, 143704, 143747, 143906, 144003, 144115)
    keys = ("time", "pos_meas1", "pos_meas2", "tau_con1", "tau_con2", "tau_meas1", "tau_meas2")

    def parse(text: bytes) -> Recording:
        table = np.genfromtxt(io.BytesIO(text), delimiter=",", names=True)
        return {key: table[key].astype(np.float32) for key in keys}

    addresses = {f"20230629-{time}": f"{place}/20230629-{time}/trajectory.csv" for time in times}
    checksum = "99d9f2445567f92765fd545f0eadf55987c4e59fd761357b5c6675697eecca16"
    return fetch_recordings("design_C1_sys_id.npz", folder, addresses, keys, parse, checksum)


def fetch_recordings(
    name: str,
    folder: Path | None,
    addresses: Mapping[str, str],
    keys: Sequence[str],
    parse: Callable[[bytes], Recording],
    checksum: str,
) -> list[Recording]:
    """Return recordings from an archive in a folder, which is fetched and written if there is none."""
    file = Path(get_data_home() if folder is None else folder) / name
    if file.exists():
        with np.load(file) as data:
            names = [f"{recording}/{key}" for recording in addresses for key in keys]
            packed = {key: data[key].astype(np.float32) for key in names}
    else:
        packed = {}
        for recording, address in addresses.items():
            with urlopen(address) as answer:
                packed |= {f"{recording}/{key}": x for key, x in parse(answer.read()).items()}
    digest = hashlib.sha256()
    for values in packed.values():
        digest.update(values.tobytes())
    if digest.hexdigest() != checksum:
        raise ValueError(f"{file} must have the checksum {checksum}, got {digest.hexdigest()}: remove it")
    if not file.exists():
        write_whole(file, lambda stream: np.savez_compressed(stream, **packed))
    return [{key: packed[f"{recording}/{key}"] for key in keys} for recording in addresses]


def mark_states(ax: Axes, probabilities: Mapping[str, float]) -> None:
    """Draw the probability of each effect, with the limits of its states as lines."""
    shown = sorted(probabilities.items(), key=lambda item: item[1])
    ax.barh([name.replace("_", " ") for name, _ in shown], [p for _, p in shown])
    ax.set(
        xlim=(0, 1), xticks=[ABSENT, NAMED, PRESENT], xlabel="probability", title="What the simulator lacks"
    )
    ax.grid(axis="x", ls=":")
    ax.set_axisbelow(False)
