"""Two cylinders differ where the errors of both do not explain it."""

import numpy as np
import pytest

from trinoc.match.bodies.cylinder_fit import Fits
from trinoc.match.bodies.cylinder_search import differs
from trinoc.numerics.vectors import complete_axes

DRAWS, SIGNIFICANCE = 4000, 0.05
# Offset (mm), tilt (rad) and radius (mm).
SIGMA = np.array([0.3, 0.4, 0.004, 0.003, 0.2])


@pytest.mark.parametrize(("larger", "share"), [(1.0, SIGNIFICANCE), (20.0, 1.0)])
def test_as_many_differ_by_chance_as_the_level_says(larger: float, share: float) -> None:
    random = np.random.default_rng(0)
    root = SIGMA[:, None] * (np.eye(5) + 0.3 * random.normal(size=(5, 5)))
    error = larger * np.sqrt(2) * random.normal(size=(DRAWS, 5)) @ root.T
    error[0] = 0.0
    axis = np.array([0.2, -0.1, 1.0]) / np.linalg.norm([0.2, -0.1, 1.0])
    across = complete_axes(axis)
    direction = axis + error[:, 2:4] @ across
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    information = np.tile(np.linalg.inv(root @ root.T), (DRAWS, 1, 1))
    none = np.zeros(DRAWS)
    fits = Fits(
        np.array([3.0, 4.0, 5.0]) + error[:, :2] @ across,
        direction,
        12.0 + error[:, 4],
        information,
        np.tile(root @ root.T, (DRAWS, 1, 1)),
        none,
        none,
        np.zeros(DRAWS, dtype=np.int64),
    )
    found = differs(fits, 0, np.arange(1, DRAWS), SIGNIFICANCE)
    assert found.mean() == pytest.approx(share, abs=0.02)
