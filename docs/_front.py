"""Draw the pictures of the front page, and the logo: ``python docs/_front.py`` (a minute or two)."""

from __future__ import annotations

import io
import re
import runpy
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cyclofeat.simulators import CycloidalGearbox, LobeDefects, simulate

DOCS = Path(__file__).parent
GEARBOX = CycloidalGearbox.steel()
WORN = LobeDefects.worn((4, 5, 6))
# Readable on a light and on a dark page; what has this ink takes the colour of the page's text.
INK = "#123456"
BLUE, RED, GREEN, GREY = "#3b86c8", "#e0483e", "#2f9e58", "#8a949e"


def draw_disc(ax: Axes, ink: str = INK) -> None:
    """Draw a wheel among the pins, its worn lobes in red."""
    per_lobe = 48
    points = 1e3 * (GEARBOX.profile.outline(WORN.worn_lobes, per_lobe) - GEARBOX.eccentricity)
    ax.fill(points.real, points.imag, color=BLUE, alpha=0.15, linewidth=0)
    ax.plot(points.real, points.imag, color=BLUE, linewidth=1.6)
    for lobe in WORN.worn_lobes:
        # From the pit before the lobe to the pit behind it.
        worn = points[(lobe * per_lobe + np.arange(-per_lobe // 2, per_lobe // 2 + 1)) % points.size]
        ax.fill(worn.real, worn.imag, color=RED, alpha=0.3, linewidth=0)
        ax.plot(worn.real, worn.imag, color=RED, linewidth=2.6, solid_capstyle="round")
    angles = 2j * np.pi * np.arange(GEARBOX.n_pins) / GEARBOX.n_pins
    for centre in 1e3 * GEARBOX.pin_circle_radius * np.exp(angles):
        pin = matplotlib.patches.Circle((centre.real, centre.imag), 1e3 * GEARBOX.pin_radius)
        pin.set(facecolor="none", edgecolor=ink, linewidth=1.0, alpha=0.7)
        ax.add_patch(pin)
    ax.add_patch(matplotlib.patches.Circle((-2.8, 0), 17, facecolor="none", edgecolor=BLUE, linewidth=1.6))
    ax.set(aspect="equal", xlim=(-72, 72), ylim=(-72, 72))
    ax.axis("off")


def draw_torque(ax: Axes) -> None:
    """Draw the torque of one turn of the lobes, healthy and worn, on the papers' free output."""
    for defects, colour, name in ((WORN, RED, "three lobes worn"), (LobeDefects.healthy(), BLUE, "healthy")):
        torque = simulate(GEARBOX, defects, duration=0.84, motion=False).torque_out[15_360:18_432]
        ax.plot(120 + np.arange(torque.size) / 25.6, torque, color=colour, linewidth=1.1, label=name)
    ax.set(xlabel="time (ms)", ylabel="torque (Nm)")


def draw_spectra(ax: Axes) -> None:
    """Draw recordings, model and corrected model of the notebook on a mismatch."""
    example = DOCS.parent / "examples" / "notebooks" / "plot_mismatch.py"
    overlays = runpy.run_path(str(example))["result"].overlays
    (overlay, *_) = (one for one in overlays if one.kind == "spectrum")
    ax.plot(overlay.x, overlay.measured.mean, color=GREY, linewidth=3, label="recordings")
    ax.plot(overlay.x, overlay.model.mean, color=RED, linewidth=1.2, linestyle="--", label="model before")
    ax.plot(overlay.x, overlay.corrected.mean, color=GREEN, linewidth=1.2, label="model after")
    ax.set(xscale="log", yscale="log", xlabel="frequency (Hz)", ylabel="torque (Nm)")
    ax.set_xticks([10, 100, 1000], ["10", "100", "1000"])


def inline_svg(figure: Figure, title: str) -> str:
    """Return a figure as an element for a page, without a size of its own."""
    drawn = io.StringIO()
    figure.savefig(drawn, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    _, _, svg = drawn.getvalue().partition("<svg ")
    svg = re.sub(r" <metadata>.*?</metadata>\n", "", svg, flags=re.DOTALL)
    svg = re.sub(r'^(.*?)height="[^"]*" (.*?)width="[^"]*" ', rf'\1\2role="img" aria-label="{title}" ', svg)
    return "<svg " + svg.replace(INK, "currentColor")


def main() -> None:
    inked = ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color")
    matplotlib.rcParams.update(dict.fromkeys(inked, INK))
    style = {"svg.fonttype": "none", "font.family": "sans-serif", "font.size": 9, "axes.spines.right": False}
    matplotlib.rcParams.update({**style, "axes.spines.top": False, "svg.hashsalt": "cyclofeat"})
    logo = Figure(figsize=(1, 1))
    draw_disc(logo.add_axes((0, 0, 1, 1)), ink=GREY)
    (DOCS / "_static" / "logo.svg").write_text(inline_svg(logo, "cyclofeat"), encoding="utf-8")
    pictures = {
        "count": (draw_disc, "A disc between its pins, three worn lobes in red"),
        "simulate": (draw_torque, "Torque of a healthy disc and of one with three worn lobes"),
        "compare": (draw_spectra, "Spectrum of recordings, of the model before and after correction"),
    }
    for name, (draw, title) in pictures.items():
        figure = Figure(figsize=(3.7, 2.6), layout="constrained")
        ax = figure.subplots()
        draw(ax)
        if ax.get_legend_handles_labels()[0]:
            figure.legend(loc="outside upper center", ncols=3, frameon=False, handlelength=1.3)
        (DOCS / "figures" / f"front_{name}.svg").write_text(inline_svg(figure, title), encoding="utf-8")


if __name__ == "__main__":
    main()
