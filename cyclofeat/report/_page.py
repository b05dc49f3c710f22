"""What all reports share: the page itself, how it is written, and words for numbers."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclofeat import __version__
from cyclofeat._files import write_whole

if TYPE_CHECKING:
    import os

    import jinja2

SIMULATED = ("simulated", "surrogate")


def target_of(path: str | os.PathLike[str]) -> Path:
    """The page to write, which is found out to be possible before the work is done."""
    target = Path(path)
    if target.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"a report is a page: its name must end in .html, got {target.name!r}")
    if not target.parent.is_dir():
        raise FileNotFoundError(f"folder {target.parent} does not exist: make it first")
    return target


def write_page(target: Path, template: str, summary: Mapping[str, Any]) -> Path:
    """Render a template of this package and write the page, whole or not at all."""
    html = environment().get_template(template).render(summary)
    return write_whole(target, lambda file: file.write(html.encode()))


def environment() -> jinja2.Environment:
    """Where the templates of this package are; every value that they are given is escaped."""
    try:
        import jinja2
    except ImportError as error:
        raise ImportError('reports need jinja2: pip install "cyclofeat[report]"') from error
    return jinja2.Environment(
        loader=jinja2.PackageLoader("cyclofeat.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def origin(sources: Sequence[str | None]) -> tuple[str, dict[str, str] | None, str]:
    """What the recordings are called, the banner where there are surrogates, and a line on their origin."""
    n, n_made = len(sources), sum(source in SIMULATED for source in sources)
    if n and all(source == "measured" for source in sources):
        return "measured", None, f"{number(n, 'recording')}, stated to be measured on a machine."
    if n_made == n and n:
        text = "torque made by a simulator. No value in this report was recorded on a machine."
        return "surrogate", {"heading": "All recordings are SURROGATE:", "text": text}, ""
    if n_made:
        text = "torque made by a simulator; what is said of the recordings holds for both kinds together."
        return "recorded", {"heading": f"{n_made} of {n} recordings are SURROGATE:", "text": text}, ""
    return "recorded", None, "The recordings do not state whether they were taken on a machine."


def versions() -> str:
    """What a report was made with, in one line."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "scikit-learn"))
    return f"cyclofeat {__version__}, Python {platform.python_version()}, {packages}"


# -- numbers as text


def number(n: int, thing: str) -> str:
    """``1 lobe``, ``2 lobes``."""
    return f"{n} {thing}" if n == 1 else f"{n} {thing}s"


def unbroken(text: str) -> str:
    """The text on one line, wherever it stands."""
    return text.replace(" ", "\N{NO-BREAK SPACE}")


def count_text(count: int, lobes: Iterable[int] | None, absolute: bool = True) -> str:
    """How many are worn, and which."""
    text = {0: "no worn lobe", 1: "1 worn lobe"}.get(count, f"{count} worn lobes")
    numbers = lobes_text(lobes, absolute)
    return f"{text}: {numbers}" if numbers else text


def lobes_text(lobes: Iterable[int] | None, absolute: bool = True) -> str:
    """Lobes as people count them, from 1."""
    numbers = ", ".join(str(int(lobe) + 1) for lobe in sorted(lobes or ()))
    return numbers if absolute or not numbers else f"{numbers} counted from the first sample"


def probability_text(probability: float) -> str:
    """A probability; what rounds to 1 is not called certain."""
    return "> 0.99" if probability >= 0.995 else f"{probability:.2f}"
