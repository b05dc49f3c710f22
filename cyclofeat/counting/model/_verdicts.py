"""Verdicts: what in the signal of a recording would spoil a count, window by window and as a whole.

The thresholds lie beyond what clean windows reach. Of 480 simulated ones (rigs R0, R1 and R2, noise of 0.05
to 0.5 Nm, 100 to 1,500 RPM) 0.6 % have a fault.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.quantities import number_of
from cyclofeat.recordings import Recording, WindowSet
from cyclofeat.signal import faults
from cyclofeat.signal.lobes import N_LINES, lobe_frequency
from cyclofeat.signal.windows import Float

# Shares of a window's samples.
_MOST_DROPPED, _MOST_CLIPPED = 0.02, 0.02
# Torque must change this often in the shortest period of the lobe lines of a count, and samples be this much
# denser, before its noise can be read off adjacent samples.
_FRESH, _DENSE = 4.0, 20.0
# Step of the converter in standard deviations; share of equal samples from which it hides the noise.
_COARSEST, _MOST_EQUAL = 0.5, 0.2
# Standard deviations of the usual noise that a sample lies off its neighbours, and of the torque: where there
# is next to no noise, impacts of the lobes are no spikes. Spikes in a window.
_JUMP, _LEAST_SPIKE, _MOST_SPIKES = 8.0, 0.25, 5
# Ratio of the noise in two input turns; share of the mean torque that hides worn lobes.
_NOISE_CHANGE, _MOST_NOISE = 1.5, 0.1
# Power of the weakest input turn over the median; fall and slope of a spectrum above the lobe lines (dB).
_WEAKEST_DB, _FALL_DB, _SLOPE_DB = -14.0, -68.0, -8.0
# Evidence from which a speed is known; its largest relative change; two measurements of one speed.
_KNOWN, _UNSTEADY, _SAME_SPEED = 0.6, 0.02, 0.004
# Quarters of a window whose speeds must agree, and how far, before they show that the angle's scale is wrong.
# A sound disc's shaft lines are taken for those of its lobes at 1 / (n_lobes + 1) beside it: the largest
# error of the scale, as a share of that.
_FEWEST_QUARTERS, _SAME_SCALE, _LARGEST_SCALE = 3, 0.006, 0.8
# Largest relative deviation of the angle's speed from the stated one: a motor's slip.
_SLIP = 0.055
# Advance of the angle in an eighth of a turn, as a multiple of the median and of the eighth before. Jitter of
# the angle from turn to turn in degrees; a motor under control reaches 5.
_ANGLE_STEPS, _MOST_JITTER = (0.5, 1.5), 8.0
# Faults begin with these texts; the reasons of a refusal recognise them by it.
_JUMP_TEXT, _SPEED_CHANGE_TEXT = "the torque jumps", "the speed changes"
# Share of the windows that must have the count where any is left out; and where a jump, which may part two
# discs, leaves none on one side of it.
_MAJORITY, _NEARLY_ALL = 0.5, 0.9
# Windows agree where their probabilities overlap by this (Bhattacharyya's coefficient).
_AGREEMENT = 0.4


def window_faults(recording: Recording, windows: WindowSet, stop_s: Float, n_lobes: int) -> tuple[str, ...]:
    """Return what would spoil the count of each window of a recording, empty where nothing would.

    Windows are of 0.98 output turns over the angle of the input; ``stop_s`` are their ends in s from the
    recording's first sample.
    """
    angle, rate = recording.input_angle(n_lobes), recording.sampling_rate
    # A window may have any speed, of a run-up too.
    stated = recording.input_speed_hz
    of_speed = "" if angle is None or stated is None else _speed_fault(angle, rate, stated)
    speeds, evidence = faults.local_speeds(windows.X, windows.sampling_rate, 1.0, n_lobes)
    reasons = []
    for k, (start, stop) in enumerate(zip(windows.start_s.tolist(), stop_s.tolist(), strict=True)):
        rows, speed = slice(round(start * rate), round(stop * rate)), n_lobes / (stop - start)
        reasons.append(
            _sample_fault(recording.torque[rows], rate, speed, n_lobes)
            or ("" if angle is None else _angle_fault(angle[rows], rate, stated or speed))
            or of_speed
            or _line_fault(speeds[k], evidence[k], n_lobes, by_angle=angle is not None)
        )
    return tuple(reasons)


def _line_fault(speeds: Float, evidence: Float, n_lobes: int, *, by_angle: bool) -> str:
    """Return what the speeds of the lobe lines in the quarters of a window show.

    Where the window was cut ``by_angle`` of a tachometer, they tell whether that is the input's.
    """
    known = evidence > _KNOWN
    # The lines of the input shaft, where they prevail, are those of lobes at 15/16 of its speed for 15 lobes.
    shaft = np.abs(speeds * (n_lobes + 1) / n_lobes - speeds[known].max(initial=0.0)) < _SAME_SPEED
    steady = speeds[known & ~shaft]
    change = float(np.ptp(steady)) if steady.size > 1 else 0.0
    if change > _UNSTEADY:
        return f"{_SPEED_CHANGE_TEXT} by {change:.1%} within the window"
    if by_angle and steady.size >= _FEWEST_QUARTERS and change < _SAME_SCALE:
        beside = float(np.median(steady)) - 1
        if _SAME_SCALE < abs(beside) < _LARGEST_SCALE / (n_lobes + 1):
            turn = "faster" if beside > 0 else "slower"
            return f"the lobes pass {abs(beside):.1%} {turn} than the angle says: is its scale right?"
    return ""


def _sample_fault(torque: Float, sampling_rate: float, input_speed_hz: float, n_lobes: int) -> str:
    """Return what is wrong with the samples of a window, the gravest first."""
    if (share := float(faults.mark_dropouts(torque).mean())) > _MOST_DROPPED:
        return f"{share:.0%} of the samples are lost: they repeat a value or lie on straight lines"
    if (share := faults.clipped_share(torque)) > _MOST_CLIPPED:
        return f"{share:.0%} of the samples are clipped at {torque.min():.4g} or {torque.max():.4g}"
    highest = N_LINES * lobe_frequency(input_speed_hz, n_lobes)
    fresh = faults.fresh_rate(torque, sampling_rate)
    if fresh < min(_FRESH * highest, 0.5 * sampling_rate):
        return (
            f"the torque changes only {fresh:.0f} times a second, too coarse for lobe lines up to "
            f"{highest:.0f} Hz"
        )
    if (step := faults.step_size(torque)) > _COARSEST * torque.std():
        return f"steps of {step:.2g} are too coarse for a torque that deviates by {torque.std():.2g}"
    fall, slope = faults.spectral_falls(torque, sampling_rate, input_speed_hz, n_lobes)
    if fall < _FALL_DB and slope < _SLOPE_DB:
        return f"a low-pass filter has removed what lobe lines up to {highest:.0f} Hz need"
    resolved = np.mean(np.diff(torque) == 0) < _MOST_EQUAL
    if resolved and sampling_rate > _DENSE * highest:  # noise shows between adjacent samples
        noise = faults.noise_level(torque)
        off = faults.jump_sizes(torque, noise)
        limit = max(_JUMP, _LEAST_SPIKE * float(torque.std()) / max(noise, np.finfo(float).tiny))
        beyond = np.flatnonzero(off > limit)
        # A step puts two adjacent samples off by the same; a spike three, the middle one by twice as much.
        middle = off[1:-1]
        spikes = int(np.sum((middle > limit) & (middle > 1.5 * off[:-2]) & (middle > 1.5 * off[2:])))
        if beyond.size > 3 * spikes:
            return f"{_JUMP_TEXT}, first {beyond[0] / sampling_rate:.3g} s after the window's start"
        if spikes > _MOST_SPIKES:
            return f"the torque has {number_of(spikes, 'spike')}"
        if (change := faults.noise_change(torque, n_lobes)) > _NOISE_CHANGE:
            return f"the noise changes by a factor of {change:.2g} within the window"
        mean = abs(float(torque.mean()))
        # A torque without its mean, of an AC-coupled meter, says nothing about the load.
        if _MOST_NOISE * mean < noise < mean:
            return f"noise of {noise:.2g} hides worn lobes: it is {noise / mean:.0%} of the mean"
    if faults.weakest_part(torque, sampling_rate, input_speed_hz, n_lobes, n_lobes) < _WEAKEST_DB:
        return "the lobes pause within the window: the shaft stood still, or the sensor was dead"
    return ""


def _angle_fault(angle: Float, sampling_rate: float, input_speed_hz: float) -> str:
    """Return what is wrong with the angle of the input within a window.

    A run-up is far from the median too, but never changes at once.
    """
    advance = np.diff(angle[:: max(1, round(sampling_rate / input_speed_hz / 8))])
    advance /= np.median(advance)
    at_once = _mark_leaps(advance[1:] / advance[:-1])
    if np.any(_mark_leaps(advance[1:]) & at_once) or np.any(_mark_leaps(advance[:-1]) & at_once):
        return "the angle jumps or stands still within the window"
    if (jitter := faults.angle_jitter(angle)) > _MOST_JITTER:
        return f"the angle jitters by {jitter:.2g} deg from turn to turn"
    return ""


def _mark_leaps(advance: Float) -> NDArray[np.bool_]:
    """Mark what lies far below or above 1."""
    return (advance < _ANGLE_STEPS[0]) | (advance > _ANGLE_STEPS[1])


def _speed_fault(angle: Float, sampling_rate: float, input_speed_hz: float) -> str:
    """Return how the usual speed of the angle differs from the stated one."""
    speed = float(np.median(np.diff(angle))) / (2 * np.pi) * sampling_rate
    if abs(speed / input_speed_hz - 1) > _SLIP:
        return f"its angle turns at {60 * speed:.4g} RPM, but {60 * input_speed_hz:.4g} RPM are stated"
    return ""


def disagreement_reason(proba: Float, faults_of_windows: Sequence[str]) -> str:
    """Return why the windows of a recording do not belong together; empty where they do.

    ``proba`` holds the probabilities of each count, shape (n_windows, n_classes), in the order of time. Only
    windows without a fault are compared, and those with a jump, which may part two discs, or with a changing
    speed, which may change unseen in the others.
    """
    changes_only = (_JUMP_TEXT, _SPEED_CHANGE_TEXT)
    compared = [not fault or fault.startswith(changes_only) for fault in faults_of_windows]
    root = np.sqrt(proba[compared])
    if not len(root) or (root @ root.T).min() >= _AGREEMENT:
        return ""
    changes = sum(before @ after < _AGREEMENT for before, after in pairwise(root))
    if changes == 1 and not any(fault.startswith(_SPEED_CHANGE_TEXT) for fault in faults_of_windows):
        return "its windows have another count from some time on: two discs in one recording?"
    return "its windows disagree about the count"


def outvoted_reason(
    proba: Float, faults_of_windows: Sequence[str], reasons: Sequence[str], column: int
) -> str:
    """Return why a count from a part of the windows is not to be trusted; empty where it is.

    What spoils one window is often in the others too, too weak to be seen: where any is left out, more than
    half of all windows must have the count, so that those left out cannot outvote it. A window that is left
    out as unlike the training, without a fault, votes too. After a jump the torque may be that of another
    disc: if no window before it is used, or none after it, nine tenths must have the count. ``reasons`` say
    why each window is left out; ``column`` of ``proba`` is the count's.
    """
    used = np.array([not one for one in reasons])
    faultless = np.array([not fault for fault in faults_of_windows])
    n_votes = int(np.sum(proba[faultless].argmax(axis=1) == column))
    jumps = [at for at, one in enumerate(reasons) if one.startswith(_JUMP_TEXT)]
    one_sided = any(not used[:at].any() or not used[at:].any() for at in jumps)
    if used.all() or n_votes > (_NEARLY_ALL if one_sided else _MAJORITY) * used.size:
        return ""
    left_out = f"{int(np.sum(~used))} left out: {most_frequent(reasons)}"
    return f"only {n_votes} of its {used.size} windows have its count, {left_out}"


def most_frequent(reasons: Sequence[str]) -> str:
    """Return the first of the most frequent reasons; they are alike if they differ in numbers only."""
    given = [reason for reason in reasons if reason]
    alike = Counter(re.sub(r"[\d.,]+", "", reason) for reason in given)
    return max(given, key=lambda reason: alike[re.sub(r"[\d.,]+", "", reason)], default="")
