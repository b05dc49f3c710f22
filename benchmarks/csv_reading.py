"""Time and memory of reading a CSV file of 8 million samples, beside pandas.

    python -m benchmarks.csv_reading     # prints both

Both read both columns (times and torque) in a process of their own, after a first short file. Memory is the
largest resident size beyond what the process held before, over the size of the two columns.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

N_SAMPLES, PART = 8_000_000, 100_000


def write_file(path: Path, n_samples: int) -> None:
    random = np.random.default_rng(0)
    with path.open("w", encoding="utf-8") as file:
        file.write("time [s],torque [Nm]\n")
        for start in range(0, n_samples, PART):
            times, torque = np.arange(start, start + PART) / 25_600, 22 + random.normal(size=PART)
            rows = zip(times.tolist(), torque.tolist(), strict=True)
            file.writelines(f"{at:.7f},{value:.4f}\n" for at, value in rows)


def measure_reader(library: str, short: str, long: str) -> dict[str, float]:
    """Return processor time in s and the memory over the columns of one library, in this process."""
    read: Callable[[str], Any]
    if library == "pandas":
        from pandas import read_csv as read
    else:
        from cyclofeat.datasets import read_recording as read
    read(short)
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    read(long)
    kibibytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    return {"seconds": time.process_time() - start, "memory": 1024 * kibibytes / (16 * N_SAMPLES)}


def main() -> None:
    if len(sys.argv) > 1:
        print(json.dumps(measure_reader(*sys.argv[1:])))
        return
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / name for name in ("short.csv", "long.csv")]
        for path, n_samples in zip(files, (PART, N_SAMPLES), strict=True):
            write_file(path, n_samples)
        results = {}
        for library in ("pandas", "cyclofeat"):
            command = [sys.executable, __file__, library, *map(str, files)]
            runs = [json.loads(subprocess.check_output(command)) for _ in range(3)]
            results[library] = {key: min(run[key] for run in runs) for key in runs[0]}
            print(
                f"{library}: {{seconds:.2f}} s, {{memory:.2f}} times the columns".format(**results[library])
            )
    ratio = results["cyclofeat"]["seconds"] / results["pandas"]["seconds"]
    print(f"processor time over pandas: {ratio:.2f}")


if __name__ == "__main__":
    main()
