"""Statements A1 to A12 of paper A, the verification on measured data, part by part.

S is simulation, M the published measurements. Only three tables of numbers of M exist. If a statement needs
its recordings, **surrogate** torque of the rig ``published`` replaces them, and the part has no verdict.
"""

from __future__ import annotations

import _papers as p
import numpy as np
from scipy.stats import spearmanr

from benchmarks._paper_b import Part, several
from cyclofeat.datasets import load_published_tables
from cyclofeat.features import NarrowbandRatio, SpectralFlatness, SpectralRolloff, WaveletEnvelopeSpectrum
from cyclofeat.features.base import WindowTransformer
from cyclofeat.signal import magnitude_squared_coherence
from cyclofeat.signal.wavelets import level_band


def course(values: np.ndarray) -> str:
    """Rank correlation with the count of each surrogate set, (n_sets, n_counts)."""
    first = 8 - values.shape[1]
    found = [spearmanr(range(first, 8), row).statistic for row in values]
    return f"surrogate sets: rank correlation with the count {several(found, '+.2f')}"


def first_feature(transformer: WindowTransformer) -> np.ndarray:
    """First feature of each surrogate set, (n_sets, n_counts)."""
    return np.array([transformer.fit_transform(records)[:, 0] for records in p.surrogate_sets()])


def a1() -> list[Part]:
    table, sets = load_published_tables().signal_statistics, p.surrogate_sets()
    std = sets.std(axis=-1, ddof=1)
    mean_off = (sets.mean() - table["mean_nm"].mean()) / table["mean_nm"].std(ddof=1)
    std_off = (np.log(std).mean() - np.log(table["std_nm"]).mean()) / np.log(table["std_nm"]).std(ddof=1)
    order = np.mean([spearmanr(range(1, 8), row[1:]).statistic for row in std])
    said = spearmanr(range(1, 8), table["std_nm"][1:]).statistic
    return [
        ("level of the mean", f"{mean_off:+.1f} scatters of the discs off (fitted)", abs(mean_off) < 1),
        ("level of the deviation", f"{std_off:+.1f} scatters off (fitted)", abs(std_off) < 1),
        (
            f"deviation falls from 1 to 7 worn (rank correlation {said:+.2f})",
            f"{order:+.2f} on average over the surrogate sets",
            order < -0.7,
        ),
    ]


def low_share(records: np.ndarray, rate: float) -> float:
    """Share of the ripple's power below 10 Hz, mean over records."""
    power = np.abs(np.fft.rfft(records - records.mean(axis=-1, keepdims=True))) ** 2
    low = np.fft.rfftfreq(records.shape[-1], 1 / rate) < 10
    return float((power[..., low].sum(axis=-1) / power.sum(axis=-1)).mean())


def a2() -> list[Part]:
    simulated = low_share(np.array([p.settled(t) for t in p.torques(p.STEEL_A)[1:]]), p.RATE)
    surrogate = low_share(p.surrogate_sets()[:, 1:], p.RIG_RATE)
    text = f"ripple's power below 10 Hz: S steel {100 * simulated:.1f} %, surrogate {100 * surrogate:.0f} %"
    return [("low frequencies matter more in M than in S", text, None)]


def a3() -> list[Part]:
    mesh = p.STEEL.input_speed_hz * p.STEEL.n_pins
    sets = p.surrogate_sets()
    transformer = WaveletEnvelopeSpectrum(p.RIG_RATE).fit(sets[0])
    low, high = level_band(transformer.level_, p.RIG_RATE)
    first = np.array([transformer.transform(records)[:, 1] for records in sets])
    return [
        ("mesh at 8.33 x 16 = 133.3 Hz", f"{mesh:.1f} Hz", abs(mesh - 133.3) < 0.1),
        ("a level holds it", f"level {transformer.level_}: {low:.0f} to {high:.0f} Hz", low <= mesh < high),
        ("its envelope's spectrum does not tell counts apart", course(first), None),
    ]


def a4() -> list[Part]:
    share = np.array([p.minima_shared_with_seven(r[1:], levels=4)[1][:, 3] for r in p.surrogate_sets()])
    found = [spearmanr(range(1, 7), row).statistic for row in share]
    text = f"surrogate sets, level 4: rank correlation with the count {several(found, '+.2f')}"
    return [("minima overlap with 7 worn: no gradual relation", text, None)]


def a5() -> list[Part]:
    means = []
    for records in p.surrogate_sets():
        frequencies, lines = magnitude_squared_coherence(records[1:], records[0], p.RIG_RATE)
        means.append(lines[:, frequencies <= 1500].mean(axis=1))
    return [("coherence: no gradual dependence", course(np.array(means)), None)]


def a6() -> list[Part]:
    published, fitted, (constant, slope) = p.table_6_from_table_4()
    bits = p.entropy_bits(p.surrogate_sets())
    error = np.abs(published - fitted).max()
    apart = float(abs(published[3] / published[4] - 1))
    strict = sum(p.falls_strictly(row[1:]) for row in bits)
    scatter = bits.std(axis=0, ddof=1).mean()
    return [
        (
            "table 6 falls strictly from 1 to 7 worn",
            f"smallest step {-np.diff(published)[1:].max():.4f} bits",
            p.falls_strictly(published[1:]),
        ),
        ("lowest for the healthy disc", f"{published[0]:.4f} bits", published.argmin() == 0),
        ("normalized: 3 and 4 almost equal", f"{100 * apart:.2f} % apart", apart < 1e-3),
        (
            "because defects scatter the spectrum",
            f"{constant:.3f} + {slope:.3f} h(a) of table 4 gives it to {error:.4f} bits",
            error > 0.01,
        ),
        (
            "reliable for the count",
            f"falls strictly in {strict} of {len(bits)} surrogate sets; assemblies of one count differ by "
            f"{scatter:.2f} bits",
            strict == len(bits),
        ),
    ]


def a7() -> list[Part]:
    table = load_published_tables().spectral_centroid["centroid"]
    order = spearmanr(range(8), table)
    rolloff = first_feature(SpectralRolloff(p.RIG_RATE))
    return [
        (
            "table 5: no gradual dependence",
            f"rank correlation {order.statistic:+.2f}, p = {order.pvalue:.2f}",
            order.pvalue > 0.05,
        ),
        ("95 % roll-off: no gradual dependence", course(rolloff), None),
    ]


def a8() -> list[Part]:
    ratio = NarrowbandRatio(p.RIG_RATE, fundamental_hz=100.0)
    return [("energy at n x 100 Hz over total: random", course(first_feature(ratio)), None)]


def a9() -> list[Part]:
    flatness = first_feature(SpectralFlatness(p.RIG_RATE, "matlab_pwelch"))
    return [("flatness does not tell counts apart", course(flatness), None)]


def a10() -> list[Part]:
    shares = {}
    for name, gearbox in (("steel", p.STEEL_A), ("H = 0.2", p.ABS), ("H = 0.1", p.SOFT_ABS)):
        frequencies, found = p.bands_of_falling_entropy(p.torques(gearbox)[1:])
        shares[name] = 100 * found.sum() / p.n_bands(frequencies.size)
    return [
        (
            "S steel: bands of strictly falling entropy",
            f"{shares['steel']:.0f} % of all bands",
            shares["steel"] > 0,
        ),
        ("S ABS: none (H = 0.1)", f"{shares['H = 0.1']:.0f} %", shares["H = 0.1"] == 0),
        ("S ABS: none (H = 0.2, which A11 asks for)", f"{shares['H = 0.2']:.0f} %", shares["H = 0.2"] == 0),
    ]


def a11() -> list[Part]:
    bands = np.arange(100, 1000, 100)

    def of(gearbox: object, wheels: tuple[int, ...]) -> np.ndarray:
        record = p.settled(p.torques(gearbox, wheels, (1,))[0])  # type: ignore[arg-type]
        return 1e3 * np.array([p.amplitude_in(record, low, low + 100) for low in bands])

    plastic, steel, steel_both, plastic_both = (
        of(p.ABS, p.ONE), of(p.STEEL_A, p.ONE), of(p.STEEL_A, p.BOTH), of(p.ABS, p.BOTH)
    )  # fmt: skip
    return [
        (
            "S ABS: raised at 400-500 Hz",
            f"{plastic[3]:.0f} mNm, its highest band (H chosen for it)",
            plastic.argmax() == 3,
        ),
        ("absent in S steel (one wheel worn)", f"{steel[3]:.0f} mNm", steel[3] < plastic[3] / 3),
        (
            "absent in S steel (both wheels)",
            f"{steel_both[3]:.0f} mNm, ABS {plastic_both[3]:.0f}",
            steel_both[3] < plastic_both[3] / 3,
        ),
        ("M: much lower high frequencies than both", "its spectra are not published as numbers", None),
    ]


def a12() -> list[Part]:
    table = load_published_tables().signal_statistics
    swing = np.abs(np.log((table["max_nm"] - table["mean_nm"]) / (table["mean_nm"] - table["min_nm"])))
    found = {}
    for name, gearbox in (("ABS", p.ABS), ("steel", p.STEEL_A)):
        records = np.array([p.settled(torque) for torque in p.torques(gearbox)])
        found[name] = (np.ptp(records, axis=1), np.abs(np.log(p.upward_over_downward(records))))
    highest = max(ptp.max() for ptp, _ in found.values())
    parts: list[Part] = [
        (
            "S has lower peak-to-peak",
            f"at most {highest:.1f} Nm, M at least {table['range_nm'].min():.1f} Nm",
            highest < table["range_nm"].min(),
        )
    ]
    for name, (_, asymmetry) in found.items():
        more = int(np.sum(asymmetry < swing))
        parts.append((f"S {name} is more symmetric", f"at {more} of 8 counts", more == 8))
    return [*parts, ("M drifts slowly (brake)", "no recordings are published", None)]
