"""Scenes that the tests of several folders of the matcher share, prepared once."""

import pytest

from tests.match.scene import VIEWS, MadeScene, made_scene
from trinoc.match.candidates.table import Candidates
from trinoc.match.candidates.triples import trinocular_candidates
from trinoc.match.observations.clutter import ClutterModel, fit_clutter


@pytest.fixture(scope="session")
def exact() -> MadeScene:
    """Thirty lines in three views, without noise."""
    return made_scene(*VIEWS, count=30, seed=31)


@pytest.fixture(scope="session")
def noisy() -> MadeScene:
    """Thirty lines in three views, with the noise that their covariances state."""
    return made_scene(*VIEWS, count=30, seed=31, noise_px=0.3)


@pytest.fixture(scope="session")
def clutter(noisy: MadeScene) -> ClutterModel:
    """Clutter of the noisy scene."""
    return fit_clutter(noisy.inputs.lines, noisy.inputs.counts)


@pytest.fixture(scope="session")
def triples(noisy: MadeScene, clutter: ClutterModel) -> Candidates:
    """Trinocular candidates of the noisy scene."""
    return trinocular_candidates(noisy.inputs.lines, (0, 1, 2), noisy.inputs.counts, clutter)
