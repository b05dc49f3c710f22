"""Score results in the format of ``cyclofeat gap --json`` against the truth: every goal beside its figure."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm, rankdata

from benchmarks._versions import version_note
from benchmarks.hidden_effects._cases import STRENGTHS, rows_of, tie_groups, truth

_FORMAT = "cyclofeat gap 1"
_CONFIDENT = 0.9
_BINS = 10
# Alternatives without names: an FIR filter with shaped noise, and a Gaussian process on the level residual.
_BLACK_BOXES = ("equaliser", "gaussian_process")


@dataclass(frozen=True)
class Goal:
    """One goal, its figure, and the number of cases behind it.

    ``met`` is None if the present results do not determine it. ``low`` and ``high`` are the ends of a
    Wilson interval of 95 % for shares, None for other figures.
    """

    name: str
    goal: str
    figure: float | None
    n: int
    met: bool | None
    low: float | None = None
    high: float | None = None
    note: str = ""


@dataclass(frozen=True)
class _Scored:
    """A result with the truth beside it."""

    case: str
    kind: str
    decoy: str
    strengths: tuple[str, ...]
    wanted: Mapping[str, Mapping[str, float]]
    result: Mapping[str, Any]

    @property
    def disagrees(self) -> bool:
        return self.result["verdict"] == "disagree"

    @property
    def names(self) -> list[str]:
        return [effect["id"] for effect in self.result.get("effects") or []]

    @property
    def ranking(self) -> list[dict[str, Any]]:
        """Candidates, best first: the ranking, or the effects if there is no ranking."""
        return list(self.result.get("ranking") or self.result.get("effects") or [])

    @property
    def first(self) -> str | None:
        """First name of the effects, else of the ranking; none without disagreement."""
        if not self.disagrees:
            return None
        if self.names:
            return self.names[0]
        return self.ranking[0]["id"] if self.ranking else None

    @property
    def confidence(self) -> float | None:
        """Probability of the first name."""
        for effect in [*(self.result.get("effects") or []), *self.ranking]:
            if effect["id"] == self.first and effect.get("probability") is not None:
                return float(effect["probability"])
        return None

    @property
    def unknown(self) -> bool:
        return bool(self.result.get("unknown"))

    @property
    def without_fit(self) -> bool:
        """True if only the first two stages were run, which name one effect."""
        return self.disagrees and not self.names and "loss" not in self.result

    @property
    def named(self) -> bool:
        """True if a name is given that is not flagged unknown."""
        return self.first is not None and not self.unknown

    @property
    def right(self) -> bool:
        return self.first in self.wanted

    @property
    def right_group(self) -> bool:
        return any(same_group(self.first, name) for name in self.wanted)


def same_group(a: str | None, b: str | None) -> bool:
    """Return True if two names are equal or in one group of ``ties.csv``."""
    return a is not None and (a == b or any({a, b} <= group for group in tie_groups()))


def wilson(k: int, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson's interval of a share k/n.

    Examples
    --------
    >>> [round(end, 4) for end in wilson(8, 10)]
    [0.4902, 0.9433]
    """
    z = float(norm.ppf(0.5 + confidence / 2))
    share = k / n
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return max(middle - half, 0.0), min(middle + half, 1.0)


def calibration_error(confidence: Sequence[float], right: Sequence[bool], bins: int = _BINS) -> float:
    """Expected calibration error: mean gap between confidence and share of right names over equal bins.

    Examples
    --------
    >>> calibration_error([0.95, 0.95, 0.55, 0.55], [True, True, True, False])
    0.05
    """
    p, hit = np.asarray(confidence, dtype=float), np.asarray(right, dtype=float)
    slot = np.minimum((p * bins).astype(int), bins - 1)
    gaps = [
        np.sum(slot == b) * abs(p[slot == b].mean() - hit[slot == b].mean())
        for b in range(bins)
        if np.any(slot == b)
    ]
    return round(float(sum(gaps) / p.size), 12)


def calibrated_error(confidence: Sequence[float], n_draws: int = 2000) -> float:
    """Expected calibration error of these confidences if they were exact; positive with few cases.

    Median over seeded draws of which names are right.

    Examples
    --------
    >>> calibrated_error([1.0, 1.0]), calibrated_error([0.5] * 4)
    (0.0, 0.25)
    """
    p, rng = np.asarray(confidence, dtype=float), np.random.default_rng(0)
    return float(
        np.median([calibration_error(p.tolist(), list(rng.random(p.size) < p)) for _ in range(n_draws)])
    )


def auroc(inside: Sequence[float], outside: Sequence[float]) -> float:
    """Chance that a case from outside has the larger score, ties counting half.

    Examples
    --------
    >>> auroc([0.1, 0.2, 0.5], [0.5, 0.9])
    0.9166666666666666
    """
    ranks = rankdata([*inside, *outside])
    n = len(outside)
    return float((ranks[len(inside) :].sum() - n * (n + 1) / 2) / (n * len(inside)))


def read_results(folder: Path) -> dict[str, dict[str, Any]]:
    """Results by case: every ``<case>.json`` of the folder.

    Raises
    ------
    ValueError
        If there is none, a file is no JSON, or it lacks a verdict. The message names the file.
    """
    known = truth()
    found, wrong = {}, []
    for path in sorted(folder.glob("case_*.json")):
        if path.stem not in known:
            wrong.append(f"{path.name} is none of the cases")
            continue
        try:
            result = json.loads(path.read_text(encoding="utf-8"))
        except (json.JSONDecodeError, UnicodeDecodeError) as error:
            wrong.append(f"{path.name} is no JSON ({error})")
            continue
        if not isinstance(result, dict) or result.get("format", _FORMAT) != _FORMAT:
            wrong.append(f'{path.name} must hold an object of the format "{_FORMAT}"')
        elif result.get("verdict") not in ("disagree", "equivalent", "unresolved"):
            wrong.append(
                f'{path.name}: verdict must be "disagree", "equivalent" or "unresolved", '
                f"got {result.get('verdict')!r}"
            )
        else:
            found[path.stem] = result
    if wrong:
        raise ValueError("; ".join(wrong[:10]))
    if not found:
        raise ValueError(f"{folder} must hold results named <case>.json, got none")
    return found


def score(results: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """All goals, the confusion of the single effects, shares by strength and decoy, and the failures.

    Parameters
    ----------
    results : mapping from case to result
        In the format of ``cyclofeat gap --json``.
    """
    known = truth()
    scored = [
        _Scored(
            case=case,
            kind=known[case]["kind"],
            decoy=known[case]["decoy"],
            strengths=tuple(effect["strength"] for effect in known[case]["effects"]),
            wanted={effect["id"]: effect["theta"] for effect in known[case]["effects"]},
            result=result,
        )
        for case, result in sorted(results.items())
    ]
    of: dict[str, list[_Scored]] = {
        kind: [one for one in scored if one.kind == kind] for kind in ("null", "single", "pair", "outside")
    }
    return {
        "goals": [asdict(goal) for goal in _goals(of)],
        "by_strength": _by_strength(of),
        "by_decoy": _by_decoy(of["null"]),
        "confusion": _confusion(of["single"]),
        "failures": [line for one in scored for line in _failures(one)],
        "cases": {kind: len(ones) for kind, ones in of.items()},
        "cases_in_all": dict(Counter(case["kind"] for case in known.values())),
        "versions": version_note(results.values()),
    }


def _share(name: str, goal: str, hits: Sequence[bool], met: Callable[[float], bool], note: str = "") -> Goal:
    n = len(hits)
    if n == 0:
        return Goal(name, goal, None, 0, None, note=note)
    k = sum(map(bool, hits))
    low, high = wilson(k, n)
    return Goal(name, goal, k / n, n, met(k / n), low, high, note)


def _number(
    name: str, goal: str, figure: float | None, n: int, met: Callable[[float], bool], note: str = ""
) -> Goal:
    if figure is None or n == 0 or math.isnan(figure):
        return Goal(name, goal, None, n, None, note=note)
    return Goal(name, goal, float(figure), n, met(float(figure)), note=note)


def _at_least(limit: float) -> Callable[[float], bool]:
    return lambda figure: figure >= limit - 1e-12


def _at_most(limit: float) -> Callable[[float], bool]:
    return lambda figure: figure <= limit + 1e-12


def _goals(of: Mapping[str, list[_Scored]]) -> list[Goal]:
    nulls, singles, pairs, outside = of["null"], of["single"], of["pair"], of["outside"]
    whole = [*singles, *pairs, *outside]
    seen = [one for one in singles if one.disagrees]
    fitted_pairs = [one for one in pairs if not one.without_fit]
    goals = [
        _share(
            'false "disagree" on nulls', "<= 5 % (20 of 400)", [one.disagrees for one in nulls],
            _at_most(0.05),
        ),
        _share(
            "any name on a null", "<= 2 %", [one.named for one in nulls], _at_most(0.02),
            "without fits: the first of the ranking",
        ),
        _share(
            "detection", ">= 95 %", [one.disagrees for one in (*singles, *pairs)], _at_least(0.95),
            "singles and pairs",
        ),
        _share(
            "right name first", ">= 95 %", [one.right for one in singles], _at_least(0.95),
            "singles; one not detected is wrong",
        ),
        _share(
            "right group first", ">= 98 %", [one.right_group for one in singles], _at_least(0.98),
            "by the groups of ties.csv",
        ),
        _share(
            "in the first three", ">= 99 %",
            [
                one.disagrees and any(each["id"] in one.wanted for each in one.ranking[:3])
                for one in singles
            ],
            _at_least(0.99),
        ),
    ]  # fmt: skip
    stated = [one for one in seen if one.confidence is not None]
    confidences = [one.confidence or 0.0 for one in stated]
    ece = calibration_error(confidences, [one.right for one in stated]) if stated else None
    bins = "singles detected, 10 bins"
    if stated:
        bins += f"; exact confidences of so few cases give {calibrated_error(confidences):.3f}"
    goals.append(_number("calibration error", "<= 0.05", ece, len(stated), _at_most(0.05), bins))
    tied = [(one, group) for one in seen for group in tie_groups() if set(one.wanted) <= group]
    goals.append(
        _share(
            "true ties reported as ties",
            ">= 95 %",
            [
                set(one.wanted) <= (tie := set(one.result.get("tie_group") or [])) and len(tie & group) > 1
                for one, group in tied
            ],
            _at_least(0.95),
            "singles detected",
        )
    )
    goals += [
        _share("unknown flagged", ">= 85 %", [one.disagrees and one.unknown for one in outside],
               _at_least(0.85), "effects from outside the library"),
        _share("known rejected", "<= 5 %", [one.unknown for one in seen], _at_most(0.05), "singles detected"),
    ]  # fmt: skip
    inside_scores, outside_scores = (
        [float(one.result["unknown_score"]) for one in ones if one.result.get("unknown_score") is not None]
        for ones in (seen, outside)
    )
    area = auroc(inside_scores, outside_scores) if inside_scores and outside_scores else None
    goals.append(
        _number(
            "AUROC of the score of unknown", ">= 0.95", area, len(inside_scores) + len(outside_scores),
            _at_least(0.95), "needs unknown_score in the results",
        )
    )  # fmt: skip
    goals.append(
        _share(
            "wrong name with confidence >= 0.9", "<= 1 %", [_confidently_wrong(one) for one in whole],
            _at_most(0.01), "a name from the right group is not wrong; a name flagged unknown does not count",
        )
    )  # fmt: skip
    goals += [
        _share("pairs, both exact", ">= 75 %", [set(one.names) == set(one.wanted) for one in fitted_pairs],
               _at_least(0.75)),
        _share("pairs, both by group", ">= 90 %", [_pair_by_group(one) for one in fitted_pairs],
               _at_least(0.9)),
    ]  # fmt: skip
    return goals + _of_parameters(singles) + _of_gap(singles, pairs) + _of_costs(whole)


def _of_parameters(singles: Sequence[_Scored]) -> list[Goal]:
    errors, covered = [], []
    for one in singles:
        for effect in one.result.get("effects") or []:
            for parameter, true in one.wanted.get(effect["id"], {}).items():
                found = (effect.get("theta") or {}).get(parameter)
                ends = (effect.get("interval") or {}).get(parameter)
                if found is not None:
                    errors.append(abs(float(found) - true) / abs(true))
                if ends is not None:
                    covered.append(bool(float(ends[0]) <= true <= float(ends[1])))
    middle = float(np.median(errors)) if errors else None
    return [
        _number("median parameter error", "<= 10 %", middle, len(errors), _at_most(0.1),
                "singles with the right name, all parameters"),
        _share("90 % intervals that cover", "85-95 %", covered, lambda x: 0.85 <= x <= 0.95,
               "singles with the right name, all parameters"),
    ]  # fmt: skip


def _grr(result: Mapping[str, Any], condition: str, alternative: str = "") -> float | None:
    source = (result.get("alternatives") or {}).get(alternative) if alternative else result.get("grr")
    value = (source or {}).get(condition)
    return None if value is None or math.isnan(float(value)) else float(value)


def _of_gap(singles: Sequence[_Scored], pairs: Sequence[_Scored]) -> list[Goal]:
    shown = [one.result for one in (*singles, *pairs) if _grr(one.result, "all") is not None]
    own = [_grr(result, "all") or 0.0 for result in shown]
    goals = [
        _number(
            "median GRR", ">= 0.80", float(np.median(own)) if own else None, len(own), _at_least(0.8),
            "held-out recordings of singles and pairs where it is defined",
        )
    ]  # fmt: skip
    with_oracle = [
        (_grr(result, "all") or 0.0, oracle)
        for result in shown
        if (oracle := _grr(result, "all", "oracle")) is not None
    ]
    ratio = None
    if with_oracle:
        of_us, of_oracle = np.median(np.array(with_oracle), axis=0)
        ratio = float(of_us / of_oracle) if of_oracle > 0 else None
    goals.append(
        _number(
            "median GRR over the oracle's", ">= 0.95", ratio, len(with_oracle), _at_least(0.95),
            "the oracle knows the effect",
        )
    )  # fmt: skip

    def wins(alternatives: Sequence[str]) -> list[bool]:
        found = []
        for one in (*singles, *pairs):
            ours = _grr(one.result, "unseen")
            theirs = [_grr(one.result, "unseen", name) for name in alternatives]
            if ours is not None and None not in theirs:
                found.append(all(ours > other for other in theirs if other is not None))
        return found

    for name in _BLACK_BOXES:
        goals.append(
            _share(f"beats {name} out of condition", ">= 90 %", wins([name]), _at_least(0.9), "unseen counts")
        )
    goals.append(
        _share("beats both black boxes out of condition", ">= 90 %", wins(_BLACK_BOXES), _at_least(0.9),
               "unseen counts")
    )  # fmt: skip
    goals.append(_share("beats the placebo", ">= 95 %", wins(["placebo"]), _at_least(0.95), "unseen counts"))
    gains = [
        float(one.result["downstream_share"])
        for one in (*singles, *pairs)
        if one.result.get("downstream_share") is not None
    ]
    goals.append(
        _number(
            "downstream: share of the oracle's gain", ">= 0.70", float(np.median(gains)) if gains else None,
            len(gains), _at_least(0.7), "median; needs downstream_share in the results",
        )
    )  # fmt: skip
    return goals


def _of_costs(whole: Sequence[_Scored]) -> list[Goal]:
    seconds = [float(one.result["seconds"]) for one in whole if one.result.get("seconds") is not None]
    return [
        _number(
            "seconds per case", "<= 300", float(np.median(seconds)) if seconds else None, len(seconds),
            _at_most(300), "median, with all baselines; needs seconds in the results",
        )
    ]  # fmt: skip


def _confidently_wrong(one: _Scored) -> bool:
    if not one.named or (one.confidence or 0.0) < _CONFIDENT:
        return False
    return not one.right_group


def _pair_by_group(one: _Scored) -> bool:
    """Return True if names and truth can be matched one to one within groups."""
    names, wanted = one.names, list(one.wanted)
    if len(names) != 2 or len(wanted) != 2:
        return False
    straight = same_group(names[0], wanted[0]) and same_group(names[1], wanted[1])
    return straight or (same_group(names[0], wanted[1]) and same_group(names[1], wanted[0]))


def _by_strength(of: Mapping[str, list[_Scored]]) -> list[dict[str, Any]]:
    rows = []
    for kind in ("single", "outside"):
        for strength in STRENGTHS:
            ones = [one for one in of[kind] if one.strengths == (strength,)]
            if ones:
                rows.append(
                    {
                        "kind": kind,
                        "strength": strength,
                        "n": len(ones),
                        "detected": sum(one.disagrees for one in ones),
                        "right name first": sum(one.right for one in ones) if kind == "single" else None,
                        "unknown": sum(one.disagrees and one.unknown for one in ones),
                    }
                )
    return rows


def _by_decoy(nulls: Sequence[_Scored]) -> list[dict[str, Any]]:
    kinds = sorted({one.decoy for one in nulls})
    return [
        {
            "nuisance": kind or "as the prior draws it",
            "n": len(ones := [one for one in nulls if one.decoy == kind]),
            "disagree": sum(one.disagrees for one in ones),
            "named": sum(one.named for one in ones),
        }
        for kind in kinds
    ]


def _confusion(singles: Sequence[_Scored]) -> dict[str, dict[str, int]]:
    found: dict[str, Counter[str]] = {}
    for one in singles:
        (name,) = one.wanted
        said = one.first or ("no name" if one.disagrees else "not detected")
        found.setdefault(name, Counter())["unknown" if one.unknown else said] += 1
    return {name: dict(counts) for name, counts in sorted(found.items())}


def _failures(one: _Scored) -> list[dict[str, Any]]:
    truly = " + ".join(one.wanted) or f"nothing ({one.decoy or 'plain'})"
    problem = ""
    if one.kind == "null":
        if one.disagrees:
            problem = 'false "disagree"' + (", and a name" if one.named else "")
    elif not one.disagrees:
        problem = "not detected"
    elif one.kind == "outside":
        if not one.unknown:
            problem = "not flagged as unknown"
    elif one.kind == "pair" and one.without_fit:
        problem = "" if one.right_group else "first name is of neither"
    elif one.unknown:
        problem = "known, but flagged as unknown"
    elif one.kind == "single" and not one.right:
        problem = "wrong name, right group" if one.right_group else "wrong name"
    elif one.kind == "pair" and set(one.names) != set(one.wanted):
        problem = "pair right by group only" if _pair_by_group(one) else "pair not found"
    if not problem:
        return []
    said = " + ".join(one.names) or one.first or "-"
    return [
        {
            "case": one.case,
            "kind": one.kind,
            "strength": " + ".join(one.strengths),
            "truth": truly,
            "said": said,
            "confidence": one.confidence,
            "problem": problem,
            "reason": reason_for(one.case, f"{one.kind} {one.decoy}".strip(), problem),
        }
    ]


def reason_for(case: str, kind: str, problem: str) -> str:
    """Reason in ``reasons.csv`` for a failure of this case, else of its kind, else an empty string."""
    found = {(row["where"], row["problem"]): row["reason"] for row in rows_of("reasons.csv")}
    return next((found[where, problem] for where in (case, kind, "any") if (where, problem) in found), "")


# Writing.


def _percent_or_number(goal: Mapping[str, Any], value: float | None) -> str:
    if value is None:
        return ""
    return f"{100 * value:.1f} %" if "%" in goal["goal"] else f"{value:.3g}"


def to_markdown(scored: Mapping[str, Any]) -> str:
    """The score as a page of tables."""
    present, total = scored["cases"], scored["cases_in_all"]
    counted = ", ".join(f"{present.get(kind, 0)} of {n} {kind}" for kind, n in sorted(total.items()))
    present_of = f"All recordings are simulated. Results present: {counted} cases."
    lines = ["# Hidden effects: score", "", present_of, ""]
    if scored["versions"]:
        lines += [scored["versions"], ""]
    rows = []
    for goal in scored["goals"]:
        if goal["figure"] is None:
            figure, interval, met = "not measured", "", ""
        else:
            figure = _percent_or_number(goal, goal["figure"])
            ends = [_percent_or_number(goal, goal[end]) for end in ("low", "high")]
            interval = f"{ends[0]} to {ends[1]}" if all(ends) else ""
            met = "yes" if goal["met"] else "**no**"
        rows.append([goal["name"], goal["goal"], figure, interval, goal["n"], met, goal["note"]])
    lines += _table(["", "goal", "figure", "95 % interval", "n", "met", ""], rows)
    for title, key in (("By strength", "by_strength"), ("Nulls by nuisance", "by_decoy")):
        if scored[key]:
            heads = list(scored[key][0])
            lines += ["", f"## {title}", ""]
            lines += _table(heads, [[row[head] for head in heads] for row in scored[key]])
    if scored["confusion"]:
        said = sorted({name for row in scored["confusion"].values() for name in row})
        lines += ["", "## Single effects: truth (rows) and first name", ""]
        lines += _table(
            ["truth", *said],
            [[name, *(row.get(each) or "" for each in said)] for name, row in scored["confusion"].items()],
        )
    lines += ["", "## Failures", ""]
    if scored["failures"]:
        heads = list(scored["failures"][0])
        lines += _table(heads, [[row[head] for head in heads] for row in scored["failures"]])
    else:
        lines.append("None.")
    return "\n".join(lines) + "\n"


def _table(heads: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[str]:
    def cell(value: Any) -> str:
        if value is None:
            return ""
        return f"{value:.3g}" if isinstance(value, float) else str(value)

    return [
        "| " + " | ".join(heads) + " |",
        "|" + "---|" * len(heads),
        *("| " + " | ".join(map(cell, row)) + " |" for row in rows),
    ]


def score_folder(folder: Path, out: Path | None = None) -> str:
    """Score a folder of results; writes ``score.md`` and ``score.json`` and returns the page."""
    scored = score(read_results(folder))
    page = to_markdown(scored)
    target = folder if out is None else out
    target.mkdir(parents=True, exist_ok=True)
    (target / "score.md").write_text(page, encoding="utf-8")
    (target / "score.json").write_text(json.dumps(scored, indent=1) + "\n", encoding="utf-8")
    return page
