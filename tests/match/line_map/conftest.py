"""The rig that images the lines and corners."""

import pytest

from tests.match.made import rig_of
from trinoc.geometry.rig import Rig

from .made_tracks import VIEWS


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_of(*VIEWS)
