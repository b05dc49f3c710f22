"""Statements B1 to B10 of paper B, the simulation study, part by part beside this simulator's figures."""

from __future__ import annotations

from collections.abc import Sequence

import _papers as p
import numpy as np
from scipy.signal import find_peaks
from scipy.stats import spearmanr

from cyclofeat.simulators import LobeDefects, SimulationRun

#: Claim, figure found here, and whether they agree (None: needs recordings that are not published).
Part = tuple[str, str, bool | None]


def several(values: Sequence[float] | np.ndarray, form: str = ".0f") -> str:
    return ", ".join(f"{value:{form}}" for value in values)


def follows(run: SimulationRun) -> bool:
    """Return True if the output turns with the input; False means that the gearbox is locked."""
    return bool(abs(np.ptp(run.output_angle) / (np.ptp(run.input_angle) / 15) - 1) < 0.1)


def b1() -> list[Part]:
    _, worn = p.peaks(p.sleeve_forces(LobeDefects.worn(1))[:, 13])
    healthy = p.run().external_forces.sum(axis=1).max()
    return [
        ("healthy external-sleeve force < 200 N", f"{healthy:.0f} N", healthy < 200),
        ("one worn lobe: a peak of about 600 N", f"{worn.max():.0f} N", abs(worn.max() / 600 - 1) < 0.2),
        ("and another > 400 N", f"{np.sum(worn > 400) - 1} in 0.6 s", np.sum(worn > 400) > 1),
    ]


def b2() -> list[Part]:
    found = {n: p.peaks(p.sleeve_forces(LobeDefects.worn(n))[:, 13])[1] for n in range(2, 8)}
    stated = {2: (2, 2), 3: (3, 3), 4: (7, 7), 5: (5, 6), 6: (5, 6), 7: (5, 6)}
    parts: list[Part] = [
        (
            f"{n} worn: {low if low == high else f'{low}-{high}'} peaks",
            f"{len(found[n])}",
            low <= len(found[n]) <= high,
        )
        for n, (low, high) in stated.items()
    ]
    highest = max(heights.max() for heights in found.values())
    side = [h for heights in found.values() for h in heights if h <= 400]
    return [
        *parts,
        ("main peaks of 600 N", f"up to {highest:.0f} N", abs(highest / 600 - 1) < 0.2),
        ("side peaks > 400 N", f"{min(side):.0f} to {max(side):.0f} N", min(side) > 400),
        ("4 worn: two above 700 N", f"{np.sum(found[4] > 700)}", np.sum(found[4] > 700) == 2),
    ]


def b3() -> list[Part]:
    change = [p.change_at_maxima(n) for n in range(1, 8)]
    return [
        (
            "internal sleeves: hardly a change up to 3 worn",
            f"{max(change[:3]):.0f} N of 163 N",
            max(change[:3]) < 16,
        ),
        ("oscillations from 5 on", f"{several(change[4:])} N for 5, 6, 7", min(change[4:]) > max(change[:4])),
        ("of up to 50 N", f"up to {max(change):.0f} N", max(change) > 40),
    ]


def b4() -> list[Part]:
    spread = 1e3 * np.array([p.settled(p.run(LobeDefects.worn(n)).torque_in).std() for n in range(9)])
    late = spread[5:].max() / spread[5:].min() - 1
    return [
        (
            "input vibration grows with the count",
            f"{several(spread)} mNm for 0 to 8",
            bool(np.all(np.diff(spread) > 0)),
        ),
        ("5 and more hard to tell apart", f"within {100 * late:.0f} %", late < 0.05),
    ]


def b5() -> list[Part]:
    start = np.array([p.first_oscillation(LobeDefects.worn(n)) for n in range(9)])
    late = [np.abs(p.oscillation(p.run(LobeDefects.worn(n)).torque_out)[1300:]).max() for n in (7, 8)]
    eight = p.run(LobeDefects.worn(8))
    return [
        (
            "8 worn: high oscillation in the first 0.12 s",
            f"{start[8]:.1f} Nm, 0 to 7 worn at most {start[:8].max():.2f} Nm",
            start[8] > 5 * start[:8].max(),
        ),
        ("convergent after 0.13 s", f"{late[1]:.2f} Nm, 7 worn {late[0]:.2f} Nm", late[1] < 1.05 * late[0]),
        (
            "because it locks",
            f"it turns, by {np.rad2deg(np.ptp(eight.output_angle)):.0f} degrees in 0.6 s",
            not follows(eight),
        ),
    ]


def b6() -> list[Part]:
    parts: list[Part] = []
    for kind, name in (("torque_in", "input"), ("torque_out", "output")):
        _, lines = p.coherence_with_healthy(kind)
        apart = min(np.abs(a - b).max() for k, a in enumerate(lines) for b in lines[:k])
        order = spearmanr(range(1, 9), lines.mean(axis=1)).statistic
        parts += [
            (f"{name}: unique per count", f"any two differ by {apart:.2f} or more at a line", apart > 0.1),
            (
                f"{name}: no gradual dependence",
                f"mean {several(lines.mean(axis=1), '.2f')} for 1 to 8, rank correlation {order:+.2f}",
                abs(order) < 0.74,  # two-sided p of 0.05 with eight values
            ),
        ]
    return parts


def b7() -> list[Part]:
    graded = p.graded_wavelets()
    rising = [name for name, rises in graded.items() if rises]
    return [
        ("mb32.3 shows a graded pattern", "levels 3 and 4 rise at every step", graded["mb32.3"]),
        ("only mb32.3 of 130", f"so do {len(rising) - 1} others of {len(graded)}", len(rising) == 1),
    ]


def b8() -> list[Part]:
    patterns = ((0, 4), (0, 3, 6), (0, 2, 4, 6), (1, 3, 5, 7))
    single = p.run(LobeDefects.worn((0,)), duration=0.75).external_forces[3000:, 0]
    zero = single[: p.LOBE_PERIOD].max(axis=1).argmax()
    right = 0
    for lobes in patterns:
        forces = p.run(LobeDefects.worn(lobes), duration=0.75).external_forces[3000:, 0]
        times = np.concatenate([find_peaks(force, height=500, distance=50)[0] for force in forces.T])
        slots = {round((time - zero) / (p.LOBE_PERIOD / 15)) % 15 for time in times}
        right += slots == set(lobes)
    claim = "patterns (1,5), (1,4,7), (1,3,5,7), (2,4,6,8): each lobe acts in its own slot"
    return [(claim, f"{right} of 4", right == 4)]


def b9() -> list[Part]:
    one = LobeDefects.removed(7, wheels=p.ONE)
    healthy = p.sleeve_forces(p.HEALTHY, "internal", duration=1.2)[2500:, 0].max()
    _, heights = p.peaks(p.sleeve_forces(one, "internal", duration=1.2)[2500:, 0], 60)
    more = max(heights[::2].mean(), heights[1::2].mean()) / healthy - 1
    four, seven = (
        p.from_200_to_800_hz(p.run(LobeDefects.removed(n, wheels=p.ONE), duration=1.2).torque_out)
        / p.from_200_to_800_hz(p.run(duration=1.2).torque_out)
        for n in (4, 7)
    )
    single = p.run(one, duration=1.2)
    both = p.run(LobeDefects.removed(7), duration=1.2)
    eight = p.run(LobeDefects.removed(8), duration=1.2)
    other = p.run(LobeDefects.removed((1, 3, 5, 7)), duration=1.2)
    slip = np.rad2deg(np.ptp((both.output_angle + both.input_angle / 15)[3000:]))
    jump = np.rad2deg(np.ptp(eight.output_angle + eight.input_angle / 15))
    return [
        ("7 removed, one wheel: runs", f"mean {p.settled(single.torque_out).mean():.1f} Nm", follows(single)),
        ("1st internal sleeve +30 % at every 2nd turn", f"{100 * more:+.0f} %", abs(more - 0.3) < 0.05),
        ("output 200-800 Hz half as high", f"{seven:.1f} times", seven < 0.7),
        ("4 removed also lower", f"{four:.1f} times", four < 1),
        ("7 removed, both wheels: locked", f"slips by {slip:.1f} degrees and turns", not follows(both)),
        (
            "8 removed: locked",
            f"does not run: jumps by {jump:.0f} degrees, {eight.external_forces.max() / 1e3:.1f} kN",
            not follows(eight),
        ),
        (
            "(2,4,6,8) removed: locked",
            f"runs, at most {other.external_forces.max():.0f} N",
            not follows(other),
        ),
    ]


def b10() -> list[Part]:
    shared, share = p.minima_shared_with_seven(p.torques(p.STEEL)[1:], levels=4)
    steps = np.diff(share[:, 2:], axis=0)
    parts: list[Part] = []
    for level in (3, 4):
        values, later = 100 * share[:, level - 1], 100 * shared[:, level - 1, 2000:].mean(axis=1)
        text = f"{several(values)} % for 1 to 6; after the ramp {several(later)} %"
        parts.append((f"level {level}: overlap grows with the count", text, p.falls_strictly(-values)))
    parts.append(
        ("but 3 and 4 have gaps", f"smallest step {100 * steps.min():+.1f} points", bool(steps.min() < 0))
    )
    return parts
