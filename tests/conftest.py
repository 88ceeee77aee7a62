"""Fixtures that several test folders share."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import hypothesis
import numpy as np
import pytest

from splatview.scene import Gaussians

# A busy machine is no failure.
hypothesis.settings.register_profile("untimed", deadline=None)
hypothesis.settings.load_profile("untimed")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files in the order in which two processes end together (`--no-loadscope-reorder` keeps it): by their
    number of tests, and windows, whose few tests take long, once the first files have compiled the kernels,
    which each window would do for itself."""
    tests = Counter(item.path for item in items)
    for path in tests:
        if path.stem.endswith("_window"):
            tests[path] += WINDOW_TESTS
    items.sort(key=lambda item: (-tests[item.path], str(item.path)))


WINDOW_TESTS = 30
"""Quick tests that a file with windows counts for."""

DATA = Path(os.environ.get("SPLATVIEW_DATA", Path(__file__).parents[2] / "shared" / "data"))
"""Trained scenes and photo sets that are not part of the repository."""


@pytest.fixture(scope="session")
def data_file() -> Callable[[str], Path]:
    """`data_file("scenes/skull.ply")`: its path; skips the test, saying so, where the file is absent."""

    def find(name: str) -> Path:
        path = DATA / name
        if not path.exists():
            pytest.skip(f"{name} is not at {DATA} (set SPLATVIEW_DATA)")
        return path

    return find


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20231)


@pytest.fixture(scope="session")
def random_gaussians() -> Callable[..., Gaussians]:
    """`random_gaussians(n, sh_degree=3, seed=0)`: splats of all shapes in a unit ball at the origin."""

    def make(n: int, *, sh_degree: int = 3, seed: int = 0) -> Gaussians:
        rng = np.random.default_rng(seed)
        direction = rng.normal(size=(n, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        sh = rng.normal(scale=0.15, size=(n, (sh_degree + 1) ** 2, 3))
        sh[:, 0] = rng.normal(scale=1.0, size=(n, 3))
        return Gaussians(
            means=(direction * rng.uniform(size=(n, 1)) ** (1 / 3)).astype(np.float32),
            quats=rng.normal(size=(n, 4)).astype(np.float32),
            log_scales=rng.normal(-3.0, 0.8, size=(n, 3)).astype(np.float32),
            opacity_logits=rng.normal(0.5, 2.0, size=n).astype(np.float32),
            sh=sh.astype(np.float32),
        )

    return make
