"""Who is who among splats that are born, moved and die."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splatview.trainer.adam import SelectiveAdam
from splatview.trainer.adam_kernels import Rates
from splatview.trainer.splats import Splats, copied
from splatview.trainer.strategies.ops import append, keep


@pytest.mark.parametrize("strategy", ["mcmc", "classic"])
def test_a_splat_keeps_its_number_and_no_number_is_given_twice(make_trainer, strategy) -> None:
    trainer = make_trainer(
        iterations=60, strategy=strategy, refine_from=0.0, refine_until=1.0, least_refine_steps=5, noise=0.0
    )
    before = trainer.splats.ids.copy()
    np.testing.assert_array_equal(before, np.arange(len(trainer.splats)))
    given, means = set(before.tolist()), {}
    while not trainer.done:
        trainer.step()
        ids = trainer.splats.ids
        assert len(ids) == len(trainer.splats) == len(np.unique(ids))
        new = set(ids.tolist()) - given
        assert all(number > max(given) for number in new)
        given |= new
        here = dict(zip(ids.tolist(), trainer.splats.arrays.means, strict=True))
        steps = [np.linalg.norm(here[i] - means[i]) for i in here if i in means]
        assert not steps or max(steps) < 0.02, "those of the same number are the same splats"
        means = {i: mean.copy() for i, mean in here.items()}
    assert len(given) > len(before), "some were born"


def test_splats_in_old_places_are_new_ones(start) -> None:
    splats = Splats(copied(start))
    optimizer, state = SelectiveAdam(splats, Rates(1, 1, 1, 1, 1)), {"rows": np.arange(len(splats))}
    earlier = splats.ids
    splats.renumber(np.array([1, 3]))
    count = len(splats)
    assert splats.ids[[0, 1, 2, 3]].tolist() == [0, count, 2, count + 1]
    assert earlier[1] == 1, "what holds the old numbers keeps them"
    optimizer.first.means[:] = 1
    keep(splats, optimizer, state, np.arange(count) != 3)  # the youngest dies ...
    append(splats, optimizer, state, start)
    assert splats.ids[count - 1] == count + 2, "... and its number with it"
    assert state["rows"].tolist() == [0, 1, 2, *range(4, count), *[0] * count]
    assert optimizer.first.means[:, 0].tolist() == [1.0] * (count - 1) + [0.0] * count


def test_parameters_and_arrays_are_the_same_memory(start) -> None:
    splats = Splats(copied(start))
    splats.arrays.means[2, 1] = 7
    assert splats.means[2, 1] == 7
    with torch.no_grad():
        splats.sh.mul_(0)
    assert (splats.arrays.sh == 0).all()
    other = Splats(copied(start))
    other.load_state_dict(splats.state_dict())
    assert torch.equal(other.means, splats.means) and other.arrays.means[2, 1] == 7
    shared = splats.arrays.means
    assert Splats(splats.arrays).arrays.means.ctypes.data == shared.ctypes.data
