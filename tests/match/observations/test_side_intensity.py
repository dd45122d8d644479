"""The density of levels beside segments integrates to one."""

import numpy as np
import pytest

from trinoc.match.observations.side_intensity import (
    _HIGHEST_LEVEL,
    _LOWEST_LEVEL,
    _level_density_in_image,
)
from trinoc.match.tuning.every_group import DEFAULT


def test_the_density_of_both_levels_integrates_to_one():
    tuning = DEFAULT.sides
    middles = np.arange(_LOWEST_LEVEL, _HIGHEST_LEVEL, tuning.bin_width) + tuning.bin_width / 2
    every = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
    density = _level_density_in_image(every, tuning)
    assert density[:, 2].sum() * tuning.bin_width**2 == pytest.approx(1.0, rel=0.02)
