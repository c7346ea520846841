"""Which worlds a data set has."""

import pytest

from oaisys_core import randomness
from oaisys_core.errors import InvalidInputError
from oaisys_dataset.plan import SPLITS, parse_splits, world_tasks


def test_every_prefix_of_the_worlds_has_the_shares_of_the_splits():
    splits = parse_splits("train=0.7,val=0.2,test=0.1")
    counts = dict.fromkeys(splits, 0)
    for task in world_tasks(5, 300, 3, splits):
        counts[task.split] += 1
        for name, share in splits.items():
            assert abs(counts[name] - share * (task.index + 1)) <= 1


def test_twelve_worlds_have_all_default_splits():
    tasks = list(world_tasks(1, 12, 3, parse_splits(SPLITS)))
    assert {task.split for task in tasks} == {"train", "val", "test"}


def test_more_worlds_keep_the_earlier_ones():
    splits = parse_splits(SPLITS)
    assert list(world_tasks(9, 100, 3, splits))[:20] == list(world_tasks(9, 20, 3, splits))


def test_a_world_has_the_seed_of_a_batch_of_render():
    tasks = list(world_tasks(4, 3, 2, {"all": 1.0}))
    assert [task.seed for task in tasks] == [randomness.batch_seed(4, n) for n in (1, 2, 3)]
    assert len({task.seed for task in tasks}) == 3


@pytest.mark.parametrize(
    "text", ["", "train", "train=0.5", "a=0.5,a=0.5", "a=nan", "a=1,b=0", "a=-1,b=2", "a b=1"]
)
def test_wrong_splits_are_refused(text):
    with pytest.raises(InvalidInputError, match="splits"):
        parse_splits(text)
