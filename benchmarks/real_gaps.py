"""What simulators of two real measurements lack, named by the engine; writes real_gaps.md.

python -m benchmarks.real_gaps [FOLDER]    # of local copies of the data

It runs the gallery's examples of the servo and of the double pendulum.
"""

from __future__ import annotations

import runpy
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks._markdown import table
from cyclofeat.gap.engine.search import Explanation

EXAMPLES = Path(__file__).parents[1] / "examples" / "gap"
INTRODUCTION = """# What simulators of two real measurements lack
Written by `python -m benchmarks.real_gaps`, which runs `examples/gap/servo.py` and `double_pendulum.py`.
Recordings held out take no part in fits, names or choices. An effect is named if recordings left out of the
fit are predicted better with it, by more than their scatter; *probably missing* means a probability of one
half or more, *missing* 0.95.
"""
TITLES = {
    "servo": """A servo swings a pendulum
Twelve recordings explained, the four of gain 400 held out. A fit of the full family of frictions leaves
38 mrad held out.
""",
    "double_pendulum": """A double pendulum with quasi-direct drives
Six recordings explained, two held out; shoulder and elbow. The model is its project's model 1.1; model 1.0
states Coulomb friction of 0.16 and 0.12 Nm, motor inertia of 6.29e-5 kg m2 and viscous friction of
0.001 Nm s/rad.
""",
}


def describe_case(name: str) -> str:
    """Run an example, and return its section of the page."""
    begin = time.process_time()
    case: dict[str, Any] = runpy.run_path(str(EXAMPLES / f"{name}.py"))
    seconds = time.process_time() - begin
    answer: Explanation = case["answer"]
    parts = case["fitted"], case["held_out"]
    errors = [
        (label, *(", ".join(f"{e:.3g}" for e in case["errors"](part, rig)) for part in parts))
        for label, rig in case["rigs"].items()
    ]
    rows = [
        (effect.replace("_", " "), f"{p:.3f}", answer.state(effect), answer.describe_sizes(effect))
        for effect, p in sorted(answer.probabilities.items(), key=lambda row: -row[1])
    ]
    ties = [f"One of {' and '.join(sorted(tie)).replace('_', ' ')} is missing." for tie in answer.ties]
    known = [effect for effect, kind in case["effects"].items() if kind.always]
    first, last = (", ".join(f"{value:.1f}" for value in row) for row in answer.remainder)
    return "\n".join(
        [
            f"## {TITLES[name]}",
            table(["", f"error, fitted ({case['unit']})", "held out"], errors),
            table(["effect", "probability", "state", "size (90 % interval)"], rows),
            f"Order: {', '.join(answer.order).replace('_', ' ') or 'none'}.",
            *ties,
            *(f"Fitted with each set: {answer.describe_sizes(effect)}." for effect in known),
            f"Remainder, in smallest differences that matter: {first} without the effects, {last} with them.",
            f"{seconds:.0f} s of a core.\n",
        ]
    )


if __name__ == "__main__":
    sys.path.insert(0, str(EXAMPLES))
    page = "\n".join([INTRODUCTION, *map(describe_case, TITLES)])
    Path(__file__).with_suffix(".md").write_text(page, encoding="utf-8")
