"""Measured torque-deflection loops of three printed cycloidal drives."""

from __future__ import annotations

import math
from importlib.resources import as_file, files
from typing import Any

import numpy as np
from sklearn.utils import Bunch

from cyclofeat.datasets._descr import descr

_DESIGNS = ("baseline", "split_pinwheel", "conic_disk")


def load_jelmerv_cycloidal() -> Bunch:
    """Load measured torque-deflection loops of three printed cycloidal drives, their run-in and geometry.

    The output was locked while the motor's torque went slowly up and down. The loops show the play, stiffness
    and friction of a real cycloidal drive, without lobe faults.

    Returns
    -------
    sklearn.utils.Bunch
        loops : list of Bunch
            28 averaged loops, each with ``kind`` ("play": about 4 Nm, "stiffness": 25 to 40 Nm), ``design``
            ("baseline", "split_pinwheel", "conic_disk"), ``state`` ("initial", "after_runin" or "preload1"
            to "preload8"), ``name`` (of the array in the file), ``torque`` of shape (n,) in Nm (the motor's,
            referred to the output) and ``deflection`` of shape (n,) in rad (the motor encoder's, referred to
            the output).
        run_in : list of Bunch
            Three records, each with ``design``, ``time`` of shape (n,) in s, not evenly spaced, and
            ``torque`` of shape (n,) in Nm.
        geometry : Bunch
            ``n_pins``, ``n_lobes``, ``n_output_rollers`` and, in m, ``pin_radius``, ``pin_circle_radius``,
            ``eccentricity``, ``clearance``, ``output_roller_radius``, ``output_roller_circle_radius``,
            ``disc_thickness``.
        DESCR : str
            Origin, licence (CC BY-SA 4.0, unlike the code's), units and what is inferred.

    Notes
    -----
    Torque is estimated from the motor's current, and all curves were read back from the source's figures:
    their points are not evenly spaced.

    Examples
    --------
    >>> data = load_jelmerv_cycloidal()
    >>> loop = next(loop for loop in data.loops if loop.name == "stiffness_baseline_initial")
    >>> loop.torque.shape == loop.deflection.shape, round(float(loop.torque.max()))
    (True, 25)
    """
    folder = files(__package__) / "jelmerv_cycloidal"
    with (
        as_file(folder / "jelmerv_cycloidal_curves.npz") as path,
        np.load(path, allow_pickle=False) as archive,
    ):
        arrays = {name: archive[name].astype(np.float64) for name in archive.files}
    loops: list[Bunch] = []
    run_in: list[Bunch] = []
    for name, array in arrays.items():
        kind, design, state = _parts(name)
        if kind == "runin":
            run_in.append(Bunch(design=design, time=array[:, 0] * 60, torque=array[:, 1]))
        else:
            labels: dict[str, Any] = {"kind": kind, "design": design, "state": state, "name": name}
            loops.append(Bunch(**labels, torque=array[:, 0], deflection=array[:, 1] * (math.pi / 180)))
    geometry = Bunch(
        n_pins=14, n_lobes=13, pin_radius=3.5e-3, pin_circle_radius=34e-3, eccentricity=1.5e-3,
        clearance=0.05e-3, n_output_rollers=8, output_roller_radius=9e-3,
        output_roller_circle_radius=20e-3, disc_thickness=25e-3,
    )  # fmt: skip
    description = descr(
        "Measured torque-deflection loops of three 3D-printed cycloidal drives, output locked.",
        origin=(
            "JelmerV, Anti-Backlash Cycloidal Actuator (MSc thesis, 2024), "
            "https://github.com/JelmerV/Anti-Backlash-Cycloidal-Actuator, commit 78d6dacc."
        ),
        licence="CC BY-SA 4.0, https://creativecommons.org/licenses/by-sa/4.0/; attribution as above.",
        units="torque in Nm and deflection in rad, both referred to the output; time in s; lengths in m.",
        inferred=(
            "torque follows from the motor's current (no torque cell); curves were read back from the "
            "source's vector figures; the design of each run-in record follows from the legend's order."
        ),
        more="\n".join((folder / name).read_text(encoding="utf-8") for name in ("README.md", "LICENSE.md")),
    )
    return Bunch(loops=loops, run_in=run_in, geometry=geometry, DESCR=description)


def _parts(name: str) -> tuple[str, str, str]:
    """Kind, design and state of an array's name."""
    if name.startswith("runin_torque_"):
        return "runin", name.removeprefix("runin_torque_"), ""
    kind, _, rest = name.partition("_")
    design = next(design for design in _DESIGNS if rest.startswith(design))
    return kind, design, rest.removeprefix(f"{design}_")
