"""Gaussians: what is accepted, what is refused by name, taking and concatenating."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.scene import concatenate
from splatview.scene.gaussians import near_plane
from splatview.scene.image_model import NEAR


def test_degree_length_and_bytes(random_gaussians):
    for degree, coefficients in enumerate((1, 4, 9, 16)):
        gaussians = random_gaussians(7, sh_degree=degree)
        assert (gaussians.sh_degree, len(gaussians)) == (degree, 7)
        assert gaussians.nbytes == 7 * 4 * (3 + 4 + 3 + 1 + 3 * coefficients)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("means", lambda a: a[:, :2]),
        ("means", lambda a: a.astype(np.float16)),
        ("quats", lambda a: a[:-1]),
        ("log_scales", lambda a: a.astype(np.float64)),
        ("opacity_logits", lambda a: a[:, None]),
        ("sh", lambda a: a[:, :5]),
        ("sh", lambda a: a[:-1]),
    ],
)
def test_a_wrong_array_is_named(random_gaussians, name, change):
    gaussians = random_gaussians(4)
    with pytest.raises(ValueError, match=name):
        replace(gaussians, **{name: change(getattr(gaussians, name))})


def test_extras_must_have_one_value_a_splat(random_gaussians):
    with pytest.raises(ValueError, match="confidence"):
        replace(random_gaussians(4), extras={"confidence": np.zeros(3)})


def test_take_keeps_rows_together(random_gaussians):
    gaussians = replace(random_gaussians(9), extras={"id": np.arange(9)}, comments=("kept",))
    taken = gaussians.take(np.array([5, 2]))
    assert taken.extras["id"].tolist() == [5, 2] and taken.comments == ("kept",)
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(taken, name), getattr(gaussians, name)[[5, 2]])


def test_concatenate_pads_sh_and_keeps_what_is_shared(random_gaussians):
    a = replace(
        random_gaussians(3, sh_degree=1), extras={"id": np.arange(3), "own": np.zeros(3)}, comments=("x",)
    )
    b = replace(random_gaussians(2, sh_degree=3), extras={"id": np.arange(2)}, comments=("y", "x"))
    b = replace(b, means=b.means.astype(np.float64))
    both = concatenate([a, b])
    assert len(both) == 5 and both.sh_degree == 3 and both.means.dtype == np.float64
    assert both.comments == ("x", "y") and list(both.extras) == ["id"]
    np.testing.assert_array_equal(both.sh[:3, :4], a.sh)
    assert not both.sh[:3, 4:].any()


@pytest.mark.parametrize(
    "comments, near",
    [
        ((), NEAR),
        (("near plane 1.5",), 1.5),
        (("Near plane: 2e-1",), 0.2),
        (("near plane 3", "near plane 0.75", "near plane 1e400"), 0.75),  # of scenes that were put together
        (("near plane 0", "near plane -2", "near plane nan", "near plane 1.2.3", "near plane"), NEAR),
        (("near plane 1e-9",), NEAR),
        (("the near plane 4",), NEAR),
    ],
)
def test_a_near_plane_that_a_file_asks_for(comments, near):
    assert near_plane(comments) == near
