"""Discs with other numbers of lobes than the papers' 15."""

import functools

import pytest
from small_model import labelled, recording

from cyclofeat.counting import LobeModel

SIZES = (11, 21)


@functools.cache
def model_of(n_lobes: int) -> LobeModel:
    return LobeModel(n_splits=0, n_trees=20, random_state=0).fit(labelled(n_lobes=n_lobes))


@pytest.mark.parametrize("n_lobes", SIZES)
@pytest.mark.parametrize("n_worn", [0, 1, 3])
def test_a_model_of_another_size_counts_and_locates(n_lobes, n_worn):
    worn = tuple(range(n_lobes - n_worn, n_lobes))  # up to the last lobe
    count = model_of(n_lobes).count(recording(worn, seed=80, turns=2, n_lobes=n_lobes))
    assert (count.defect_count, count.lobes, count.n_windows) == (n_worn, worn, 2)
    assert not count.refused
    assert len(count.lobe_probability) == n_lobes


@pytest.mark.parametrize("n_lobes", SIZES)
def test_it_follows_the_speed_without_a_tachometer(n_lobes):
    one = recording((4, 5, 6), seed=81, turns=2, n_lobes=n_lobes)
    count = model_of(n_lobes).count(one.replace(angle=None, angle_is_absolute=False, speed_rpm=505))
    assert (count.defect_count, count.refused) == (3, False)


def test_a_disc_of_another_size_is_an_error():
    with pytest.raises(ValueError, match="n_lobes of the recording is 21, .* trained for discs of 11"):
        model_of(11).count(recording((1,), n_lobes=21))
    with pytest.raises(ValueError, match="n_lobes must be the same for all recordings, got 11, 21"):
        LobeModel().fit([recording((1,), n_lobes=n_lobes) for n_lobes in SIZES])
