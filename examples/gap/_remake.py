"""Simulate the statistics of ``data/published_tables.npz`` again: 2500 records, half an hour on one core."""

from _stored import DATA

from cyclofeat.datasets import load_published_tables
from cyclofeat.gap import Comparison
from cyclofeat.gap.cases.published_table import published_session
from cyclofeat.gap.engine.search import explain

if __name__ == "__main__":
    session = published_session(Comparison(sampling_rate=25_600), load_published_tables().signal_statistics)
    explain(session)
    session.problem.save(DATA / "published_tables.npz")
