"""How a gap was found, and from what, as its page states it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from cyclofeat._base.quantities import in_words
from cyclofeat.plotting.gap_words import p_words
from cyclofeat.report._page import versions_line

if TYPE_CHECKING:
    from cyclofeat.gap import GapResult
    from cyclofeat.gap.where.conditions import Where


def method_rows(result: GapResult) -> list[tuple[str, str]]:
    """Method in short: heading and text of each part."""
    parts = _describe_comparison(result.where[0], result.where[0].alpha * len(result.where))
    tests = [
        f"{one.condition.text}: {', '.join(f'{name} {p_words(p)}' for name, p in one.global_p.items())}"
        for one in result.where
        if one.global_p
    ]
    if tests:
        parts.append(("All numbers together", f"Tests in addition to the verdict. {'; '.join(tests)}."))
    if result.effects:
        parts.append((
            "Naming and size",
            f"Rigs with random sets of {len(result.effects)} effects, of random sizes, were simulated at "
            "random conditions; from them it was learned how probable each effect is, given recordings, and "
            "how large. An effect is called missing, or not missing, where one of the two is almost certain; "
            "else it is open. The ranges of sizes hold with 90 %.",
        ))  # fmt: skip
    if result.remainder is not None:
        parts.append((
            "Left unexplained",
            "The corrected model is simulated at all conditions and compared with the recordings, number by "
            "number and all together. Where they differ, so are rigs that have the open effects too, each as "
            "often as it is probable.",
        ))  # fmt: skip
    if result.proof:
        parts.append((
            "Gap closed",
            "1 - (after - floor) / (before - floor), with distances between the recordings held out and the "
            "simulator, in standard deviations of one recording. The floor is the distance between two "
            "halves of the recordings. The range comes from resampling the recordings.",
        ))  # fmt: skip
    return parts


def _describe_comparison(where: Where, alpha: float) -> list[tuple[str, str]]:
    assemblies = (
        "All recordings are stated to be of one assembly; they count as fewer, because they share its errors."
        if where.one_assembly
        else "Each recording counts as one of a different assembly."
    )
    return [
        (
            "Comparison",
            f"Each recording is summarised by {where.n_cells} numbers, and so are {where.n_simulated} "
            "recordings of the model, in which start angle, position of the wear, speed, load and pins vary "
            "as they may without a missing effect. The means are compared, and also whether recordings vary "
            "more from one to the next than simulated ones. Differences that follow a recording's own speed "
            f"and mean torque count as explained, as far as both vary in the model. {assemblies}",
        ),
        (
            "p",
            f"The labels of recordings are shuffled {where.n_permutations} times; p is the share of shuffles "
            "with a difference at least as clear, corrected for the number of comparisons within a group "
            "(Westfall and Young), for the number of groups (Holm) and for that of conditions (Bonferroni). "
            f"A p of at most {alpha:.2g} counts as a difference. A recording is one unit, however long.",
        ),
        (
            "Agreement",
            f"Agreement is shown only if every range lies within {where.margin_db:g} dB, or within "
            f"{where.margin_spreads:g} standard deviations of one recording. If neither difference nor "
            "agreement is shown, the answer is open.",
        ),
    ]


def provenance_rows(result: GapResult, settings: dict[str, Any]) -> list[tuple[str, str]]:
    """Settings and circumstances: label and text of each."""
    where = result.where[0]
    known = {
        "recordings": sum(one.n_recordings for one in result.where),
        "conditions": "; ".join(one.condition.text for one in result.where),
        "simulated recordings": sum(one.n_simulated for one in result.where),
        "quantity": in_words(result.quantity),
        "sampling rate": f"{where.sampling_rate:g} Hz",
        "random state": where.random_state,
    }
    if math.isfinite(result.seconds):
        known["computing time"] = f"{result.seconds:.0f} s"
    shown = settings | {name: text for name, text in known.items() if name not in settings}
    return [(str(name), str(text)) for name, text in (shown | {"versions": versions_line()}).items()]
