"""The whole workflow on rigs of an independent generator, with one to five effects at once.

The sets are some of those that the posterior of the package answers rightly; how many it does is the
benchmark's to say (``make bench-gap``).
"""

from __future__ import annotations

import pytest

from benchmarks.hidden_effects._answers import answers
from benchmarks.hidden_effects._ask import whole_answer
from benchmarks.hidden_effects._folders import generate
from cyclofeat.gap import GapSettings, load_posterior

pytestmark = pytest.mark.bench  # tests/gap/test_confirm.py goes the whole way on a small world

SETS = ("set_00acf5d6", "set_82e7b299", "set_24cd4a2b", "set_2dbea1c0", "set_9d431f15", "set_515d2d0a")
SETTINGS = GapSettings(pictures=False, n_bank=40, n_report=24, n_permutations=499, random_state=0)


@pytest.mark.parametrize("name", SETS)
def test_all_that_is_hidden_is_named_and_closes_the_gap(name, tmp_path):
    generate((name,), tmp_path, 1)
    result = whole_answer(name, tmp_path, load_posterior(), SETTINGS)
    (answer,) = answers({name: result})
    assert answer.right
    assert not answer.wrong_claim
    closed = [proof["closed"]["after"]["all"] for proof in result["proof"]]
    stated = [share for share in closed if share is not None]
    assert stated
    assert min(stated) > 0.5
