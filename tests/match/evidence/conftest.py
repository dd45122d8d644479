"""A scene so exact that a projection is as good as linear within its errors."""

import pytest

from tests.match.scene import VIEWS, MadeScene, made_scene


@pytest.fixture(scope="session")
def precise() -> MadeScene:
    """Thirty lines in three views, with little noise, which is stated."""
    return made_scene(*VIEWS, count=30, seed=31, noise_px=0.02, sigma_px=0.02)
