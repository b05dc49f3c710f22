"""Page that shows the gearbox turning: wheels, sleeves, contact forces and the torque."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.displays import thin_samples
from cyclofeat._base.quantities import lobes_text
from cyclofeat.report._page import check_page_path, count_text, write_page

if TYPE_CHECKING:
    import os

    from cyclofeat.simulators import SimulationRun

Complex = NDArray[np.complex128]

MOST_FRAMES = 5000
_OUTLINE_POINTS_PER_LOBE = 40
_TRACE_POINTS = 4000
# Quantile of the forces whose arrow is longest: a single impact must not shrink all others.
_LONGEST_ARROW = 0.999


def write_animation(
    run: SimulationRun,
    path: str | os.PathLike[str],
    *,
    frames: int = 720,
    part: tuple[float, float | None] = (0.0, None),
    title: str = "",
) -> Path:
    """Write a page that shows the gearbox turning, an HTML file that needs no network, and return its path.

    The page shows both wheels between their sleeves, the force of each contact as an arrow, the worn lobes,
    and the torque beside them. It plays at several speeds, stops and steps, with mouse or keyboard. A file of
    that name is replaced.

    Parameters
    ----------
    run : cyclofeat.simulators.SimulationRun
        With forces and points: ``simulate(..., forces=True, points=True)``.
    path : path-like
        File to write, ``*.html``.
    frames : int, default=720
        Moments at which forces are shown, equally spaced, from 2 to 5000; between them the picture is
        interpolated. A whole output turn in 720 frames has 48 frames per input turn.
    part : tuple of float, default=(0.0, None)
        Beginning and end in s from the first sample of the run; None is its end.
    title : str, optional
        Heading.

    Returns
    -------
    pathlib.Path

    Raises
    ------
    ValueError
        If the run holds no forces and points, or an argument is out of its range.

    Notes
    -----
    Wheels are drawn at their kinematic angles, theta_k = rest - phi/z_s (paper B's rest position), without
    the deflection of contacts: tenths of a millimetre at most, where a worn lobe passes. Forces and points of
    contact, of sleeves on the wheel, are those of the simulation.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from cyclofeat.report import write_animation
    >>> from cyclofeat.simulators import LobeDefects, simulate
    >>> run = simulate(None, LobeDefects.worn(1), duration=0.3, forces=True, points=True)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = write_animation(run, pathlib.Path(folder, "gearbox.html"), part=(0.2, None), frames=40)
    ...     "<svg" in file.read_text(encoding="utf-8")
    True
    """
    check_page_path(path)
    if run.external_forces is None or run.external_points is None or run.internal_points is None:
        raise ValueError("run must hold forces and points: simulate(..., forces=True, points=True)")
    if not 2 <= frames <= MOST_FRAMES:
        raise ValueError(f"frames must lie between 2 and {MOST_FRAMES}, got {frames!r}")
    n_samples = run.torque_out.size
    end = n_samples / run.sampling_rate
    start_s, stop_s = part[0], end if part[1] is None else part[1]
    if not 0 <= start_s < stop_s <= end * (1 + 1e-9):
        raise ValueError(f"part must lie in order within the run's {end:g} s, got {start_s:g} and {stop_s:g}")
    first, last = round(start_s * run.sampling_rate), round(stop_s * run.sampling_rate) - 1
    if last - first < 1:
        raise ValueError(f"part from {start_s:g} to {stop_s:g} s must hold two samples at least")
    picked = np.linspace(first, last, frames).round().astype(int)
    machine = _machine_geometry(run) | _frame_angles_and_forces(run, picked) | _torque_trace(run, first, last)
    gearbox, (wear, depth) = run.gearbox, _wear_in_words(run)
    ends = [machine["force_scale"] * (k / 5) ** 2 for k in range(6)]
    ranges = [f"{low:.3g} to {high:.3g} N" for low, high in pairwise(ends)]
    summary = {
        "title": title or "The gearbox turning",
        "surrogate": {
            "heading": "SIMULATED:",
            "text": "every force and torque here was made by a simulator. Nothing was recorded on a machine.",
        },
        "origin": "",
        "worn": wear,
        "steps": [f"below {ends[1]:.3g} N", *ranges[1:4], f"above {ends[4]:.3g} N"],
        "machine": machine,
        "provenance": {
            "gearbox": f"{gearbox.n_lobes} lobes, {gearbox.n_pins} external and "
            f"{gearbox.n_internal_sleeves} internal sleeves",
            "eccentricity": f"{1e3 * gearbox.eccentricity:g} mm",
            "wear": wear + depth,
            "input speed": f"{gearbox.input_speed * 60 / (2 * math.pi):.5g} RPM",
            "load": f"{gearbox.load_torque:.4g} Nm",
            "shown": f"{stop_s - start_s:.4g} s in {frames} frames, forces as they were at that moment",
            "integration step": f"{run.dt:g} s",
        },
    }
    return write_page(path, "animation.html", summary, scripts=["animation.js"])


def _wear_in_words(run: SimulationRun) -> tuple[str, str]:
    """Return which lobes are worn or removed, and how deep the wear is."""
    defects, n_lobes = run.defects, run.gearbox.n_lobes
    parts = []
    if defects.worn_lobes or not defects.removed_lobes:
        parts.append(count_text(len(defects.worn_lobes), defects.worn_lobes, n_lobes))
    if defects.removed_lobes:
        parts.append(f"removed lobes: {lobes_text(defects.removed_lobes, n_lobes)}")
    if defects.defect_count and len(defects.wheels) == 1:
        parts.append(f"on wheel {defects.wheels[0] + 1} only")
    depth = ""
    if defects.worn_lobes and defects.wear_um is None:
        depth = f", depth {defects.depth:g}"
    elif defects.worn_lobes and defects.wear_um is not None:
        depths = dict.fromkeys(f"{value:g}" for value in np.ravel(defects.wear_um))
        depth = f", radial, {' and '.join(depths)} um (not drawn)"
    return "; ".join(parts), depth


def _machine_geometry(run: SimulationRun) -> dict[str, Any]:
    """Geometry in mm; each wheel in its own frame, with the tip of lobe 0 on the x axis."""
    from cyclofeat.simulators import LobeDefects

    gearbox, z = run.gearbox, run.gearbox.n_lobes
    profile = gearbox.profile
    wheels = []
    for wheel in range(2):
        defects = run.defects if wheel in run.defects.wheels else LobeDefects.healthy()
        worn, removed = defects.worn_lobes, defects.removed_lobes
        # Radial wear is too small to draw; a removed lobe is a recess from tip to tip.
        outline = profile.outline(worn if defects.wear_um is None else (), _OUTLINE_POINTS_PER_LOBE).copy()
        for lobe in removed:
            part = slice(lobe * _OUTLINE_POINTS_PER_LOBE + 1, (lobe + 1) * _OUTLINE_POINTS_PER_LOBE)
            outline[part] *= 0.93 * np.abs(outline).min() / np.abs(outline[part])
        wheels.append({
            "rest": round(_rest_angles(z)[wheel], 6),
            "cam": round((-1) ** wheel * 1e3 * gearbox.eccentricity, 4),
            "outline": (1e3 * np.column_stack([outline.real, outline.imag])).round(2).ravel().tolist(),
            "worn": list(worn),
            "removed": list(removed),
        })  # fmt: skip
    return {
        "n_lobes": z,
        "n_pins": gearbox.n_pins,
        "n_sleeves": gearbox.n_internal_sleeves,
        "pin_circle": _to_mm(gearbox.pin_circle_radius),
        "pin_radius": _to_mm(gearbox.pin_radius),
        "sleeve_circle": _to_mm(gearbox.internal_pitch_radius),
        "sleeve_radius": _to_mm(gearbox.internal_sleeve_radius),
        "hole_radius": _to_mm(gearbox.internal_sleeve_radius + gearbox.eccentricity + gearbox.clearance),
        "pit": _to_mm(abs(profile.point(math.pi / z))),
        "wheels": wheels,
    }


def _rest_angles(n_lobes: int) -> tuple[float, float]:
    """Angles of the wheels in rad where the input's is 0."""
    return -math.pi / n_lobes, 2 * math.pi * ((n_lobes + 1) // 2 - 1) / n_lobes


def _frame_angles_and_forces(run: SimulationRun, picked: NDArray[np.int64]) -> dict[str, Any]:
    """Angles, and the force of each sleeve on each wheel as whole N along x and y."""
    gearbox = run.gearbox
    phi = run.input_angle[picked]
    psi = -phi / gearbox.n_lobes if run.output_angle is None else run.output_angle[picked]
    pins = gearbox.pin_circle_radius * np.exp(2j * np.pi * np.arange(gearbox.n_pins) / gearbox.n_pins)
    place = 2 * np.pi * np.arange(gearbox.n_internal_sleeves) / gearbox.n_internal_sleeves
    sleeves = gearbox.internal_pitch_radius * np.exp(1j * (place + psi[:, np.newaxis]))
    external = _force_vectors(run.external_forces, run.external_points, picked, pins)
    internal = _force_vectors(run.internal_forces, run.internal_points, picked, sleeves[:, np.newaxis])
    sizes = np.abs(np.concatenate([external.ravel(), internal.ravel()]))
    largest = float(np.quantile(sizes[sizes > 0], _LONGEST_ARROW)) if np.any(sizes > 0) else 1.0
    steps = np.array([1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10]) * 10.0 ** math.floor(math.log10(largest))
    round_up = float(steps[steps >= largest * (1 - 1e-9)][0])
    return {
        "phi": phi.round(4).tolist(),
        "psi": psi.round(5).tolist(),
        "external": _whole_newtons(external),
        "internal": _whole_newtons(internal),
        "force_scale": round_up,
        "largest_force": round(float(sizes.max())),
    }


def _force_vectors(forces: Any, points: Any, picked: NDArray[np.int64], centres: Complex) -> Complex:
    """Force on the wheel as a vector: it points from the sleeve's centre to where it touches."""
    away = points[picked] - centres
    size = np.abs(away)
    return np.where(size > 0, forces[picked] * away / np.where(size > 0, size, 1.0), 0.0)


def _torque_trace(run: SimulationRun, first: int, last: int) -> dict[str, Any]:
    """Torque over time from the first frame on, and times at which the cam points at a defect."""
    part = slice(first, last + 1)
    time = np.arange(last + 1 - first) / run.sampling_rate
    times, values = thin_samples(time, run.torque_out[part], _TRACE_POINTS)
    z, defects = run.gearbox.n_lobes, run.defects
    marked = np.zeros(time.size, dtype=int)
    for wheel in defects.wheels:
        cam_in_wheel = (z + 1) / z * run.input_angle[part] + wheel * np.pi - _rest_angles(z)[wheel]
        lobe = np.floor(cam_in_wheel * z / (2 * np.pi) + 0.5).astype(int) % z
        marked |= np.isin(lobe, [*defects.worn_lobes, *defects.removed_lobes])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marked, [0]])))
    bands = time[np.minimum(edges, time.size - 1)].round(5).reshape(-1, 2)
    return {
        "duration": round(float(time[-1]), 6),
        "trace_times": times.round(5).tolist(),
        "trace": values.round(3).tolist(),
        "bands": bands.tolist(),
    }


def _to_mm(length: Any) -> float:
    return round(1e3 * float(length), 4)


def _whole_newtons(vectors: Complex) -> list[list[int]]:
    """x, y of every sleeve in whole N, wheel by wheel, for each frame."""
    pairs = np.stack([vectors.real, vectors.imag], axis=-1).round().astype(int)
    return pairs.reshape(len(vectors), -1).tolist()
