"""The scores by which the posterior and its peers are compared."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.posterior_peers.__main__ import HEAD, Answers, Scale, row


class Judged:
    """Four rigs with two effects of one size each."""

    present = np.array([[True, False], [False, False], [True, True], [False, True]])
    sizes = np.where(present, [[1.0, 5.0], [0, 0], [3.0, 9.0], [0, 7.0]], np.nan)

    def __len__(self):
        return len(self.present)


def scored(presence, error=0.0, width=1.0):
    scale = Scale(Judged.sizes)
    middle = np.nan_to_num(scale(Judged.sizes)) + error
    said = Answers(np.asarray(presence, dtype=float), middle - width, middle, middle + width, 2.0, 0.1)
    return dict(zip(HEAD, row("one", said, Judged(), scale), strict=True))


def test_answers_that_are_all_right_lose_nothing():
    found = scored(Judged.present)
    assert float(found["loss, nats"]) == pytest.approx(0, abs=0.01)
    assert [found[name] for name in HEAD[2:8]] == ["1.000", "1.000", "0.000", "0.000", "0.00", "1.00"]


def test_a_name_without_effects_an_error_and_intervals_that_miss_are_counted():
    presence = Judged.present.copy()
    presence[1, 0] = True
    found = scored(presence, error=0.5, width=0.4)
    assert float(found["loss, nats"]) == pytest.approx(-np.log(1e-3) / 4, abs=0.01)
    assert found["names right"] == "0.800"
    assert found["a wrong name without effects"] == "1.000"
    assert (found["median error of sizes"], found["90 % intervals that cover"]) == ("0.50", "0.00")
