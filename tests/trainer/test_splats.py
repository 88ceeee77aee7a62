"""Who is who among splats that are born, moved and die."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.trainer.splats import fresh


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
        here = dict(zip(ids.tolist(), trainer.splats.parameters.means, strict=True))
        steps = [np.linalg.norm(here[i] - means[i]) for i in here if i in means]
        assert not steps or max(steps) < 0.02, "those of the same number are the same splats"
        means = {i: mean.copy() for i, mean in here.items()}
    assert len(given) > len(before), "some were born"


def test_splats_in_old_places_are_new_ones(start) -> None:
    splats = fresh(start)
    earlier = splats.ids
    splats.renumber(np.array([1, 3]))
    count = len(splats)
    assert splats.ids[[0, 1, 2, 3]].tolist() == [0, count, 2, count + 1]
    assert earlier[1] == 1, "what holds the old numbers keeps them"
    last = splats.take(np.arange(count) != 3)  # the youngest dies ...
    assert last.joined(start).ids[count - 1] == count + 2, "... and its number with it"
