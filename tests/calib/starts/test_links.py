"""A link of two cameras is accepted if more shots agree on it than by chance."""

import numpy as np
import pytest

from trinoc.calib.starts.links import Link
from trinoc.geometry import Pose


@pytest.mark.parametrize(
    ("shared", "agreeing", "holds"),
    [(1, 1, True), (2, 1, False), (2, 2, True), (6, 2, True), (7, 2, False), (9, 3, True)],
)
def test_two_shots_and_a_third_of_all_agree(shared: int, agreeing: int, holds: bool) -> None:
    assert Link(Pose(np.eye(3, 4)), shared, agreeing).holds is holds
