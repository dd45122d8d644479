"""A scene with errors so small that the projection is linear within them."""

import pytest

from tests.match.scene import VIEWS, MadeScene, made_scene


@pytest.fixture(scope="session")
def precise() -> MadeScene:
    """Thirty lines in three views, with little noise and covariances that state it."""
    return made_scene(*VIEWS, count=30, seed=31, noise_px=0.02, sigma_px=0.02)
