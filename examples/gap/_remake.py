"""Simulate the statistics of ``data/published_tables.npz`` again: 3000 records, half an hour on one core."""

from _stored import DATA

from cyclofeat.datasets import load_published_tables
from cyclofeat.gap import Comparison, find_published_gap

if __name__ == "__main__":
    tables = load_published_tables()
    entropy = tables.spectral_entropy["entropy_bits"]
    gap = find_published_gap(Comparison(sampling_rate=25_600), tables.signal_statistics, entropy)
    gap.save_table(DATA / "published_tables.npz")
    print(f"{gap.n_simulated} records simulated, {gap.n_failed} failed")
