"""Page of a report: template, writing, and words for numbers.

Every page is a dictionary of plain values that a template renders.
"""

from __future__ import annotations

import base64
import hashlib
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclofeat import __version__
from cyclofeat._base import quantities
from cyclofeat._base.files import check_parent, package_versions, write_whole
from cyclofeat._base.quantities import number_of, probability_text

if TYPE_CHECKING:
    import jinja2

_SCRIPTS_OF_PLOTS = ("uplot/LICENSE", "uplot/uPlot.iife.min.js", "plot.js")


class Section(os.PathLike[str]):
    """Place of a page within another one: given as its path, it keeps the page's template and summary."""

    def __init__(self) -> None:
        self.template = ""
        self.summary: Mapping[str, Any] = {}

    def __fspath__(self) -> str:
        return "section.html"


def check_page_path(path: str | os.PathLike[str]) -> Path:
    """Check name, folder and jinja2 of a page ``*.html`` before the work for it, and return its path."""
    target = Path(path)
    if target.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"a report is a page: its name must end in .html, got {target.name!r}")
    check_parent(target)
    template_environment()
    return target


def write_page(
    path: str | os.PathLike[str],
    template: str,
    summary: Mapping[str, Any],
    scripts: Sequence[str] = _SCRIPTS_OF_PLOTS,
) -> Path:
    """Render a template of this package with scripts, by default those of plots, and write the whole page."""
    if isinstance(path, Section):
        path.template, path.summary = template, summary
        return Path(path)
    folder = files("cyclofeat.report").joinpath("templates")
    parts = {name: folder.joinpath(name).read_text(encoding="utf-8") for name in scripts}
    script = "\n".join(f"/*\n{text}\n*/" if "LICENSE" in name else text for name, text in parts.items())
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    html = template_environment().get_template(template).render(summary, script=script, script_digest=digest)
    return write_whole(Path(path), lambda file: file.write(html.encode()))


def template_environment(*packages: str) -> jinja2.Environment:
    """Return the environment of the templates of some packages and this one, which escapes every value."""
    try:
        import jinja2
    except ImportError as error:
        raise ImportError("reports need jinja2: pip install jinja2") from error
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader(
            [*map(jinja2.PackageLoader, packages), jinja2.PackageLoader("cyclofeat.report")]
        ),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals.update(version=__version__, versions_line=versions_line, range_text=range_text)
    words = (count_text, number_of, percent_text, probability_text)
    environment.filters.update({function.__name__: function for function in words})
    return environment


def describe_origin(sources: Sequence[str | None]) -> tuple[str, dict[str, str] | None, str]:
    """Return the name of the recordings, the banner for surrogates, and a line on their origin."""
    n, n_made = len(sources), sum(source in ("simulated", "surrogate") for source in sources)
    if n and all(source == "measured" for source in sources):
        return "measured", None, f"{number_of(n, 'recording')}, stated to be measured on a machine."
    if n_made == n and n:
        text = "torque made by a simulator. No value in this report was recorded on a machine."
        return "simulated recordings", {"heading": "All recordings are SIMULATED:", "text": text}, ""
    if n_made:
        text = "torque made by a simulator; what is said of the recordings holds for both kinds together."
        return "recordings", {"heading": f"{n_made} of {n} recordings are SIMULATED:", "text": text}, ""
    return "recordings", None, "The recordings do not state whether they were taken on a machine."


def versions_line() -> str:
    """Return the versions that a report was made with, in one line."""
    used = package_versions("cyclofeat", "python", "numpy", "scipy", "scikit-learn")
    return ", ".join(f"{'Python' if name == 'python' else name} {version}" for name, version in used.items())


def keep_together(text: str) -> str:
    """Return the text with spaces that do not break lines."""
    return text.replace(" ", "\N{NO-BREAK SPACE}")


def count_text(count: int, lobes: Iterable[int] | None = (), n_lobes: int | None = None) -> str:
    """Return the number of worn lobes, and which, in words."""
    text = number_of(count, "worn lobe") if count else "no worn lobe"
    numbers = quantities.lobes_text(lobes, n_lobes)
    return f"{text}: {numbers}" if numbers else text


def percent_text(share: float) -> str:
    return keep_together(f"{100 * float(share):.0f} %") if math.isfinite(share) else "not defined"


def range_text(low: float, high: float) -> str:
    if not (math.isfinite(low) and math.isfinite(high)) or low == high:
        return ""
    return f"{100 * float(low):.0f} to {percent_text(high)}"


def signed_text(value: float) -> str:
    return f"{value:+.2g}" if abs(value) < 10 else f"{value:+.0f}"


def rounded_text(value: float) -> str:
    """Return two significant digits, without powers of ten."""
    if value < 10:
        return f"{value:.2g}"
    digits = 1 - math.floor(math.log10(value))
    return f"{round(value, digits):.0f}"
