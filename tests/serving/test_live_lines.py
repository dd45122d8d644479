"""Lines of the demo's scene, as a page shows them."""

from pathlib import Path

import cv2
import numpy as np
import pytest

import trinoc
from trinoc.io.images import read_image
from trinoc.serving.live_lines import match_moment
from trinoc.serving.sources import Moment
from trinoc.synth import table1_rig

DEMO = Path(trinoc.__file__).parent / "synth" / "demo"


@pytest.mark.slow
def test_matched_lines_are_drawn_in_colours_that_the_pictures_do_not_have() -> None:
    rig = table1_rig()
    pictures = {name: read_image(DEMO / f"scene_{name}.png") for name in rig.names}
    lines = match_moment(Moment("now", pictures), rig)
    assert "lines of the scene are matched" in lines.sentence
    for name in rig.names:
        drawn = cv2.imdecode(np.frombuffer(lines.thumbnails[name], np.uint8), cv2.IMREAD_COLOR)
        assert drawn is not None
        assert (np.ptp(drawn.astype(int), axis=2) > 80).sum() > 500
        assert " lines matched, " in lines.captions[name]


def test_a_scene_without_edges_has_no_lines() -> None:
    blank = {name: np.full((480, 512), 90, np.uint8) for name in table1_rig().names}
    lines = match_moment(Moment("now", blank), table1_rig())
    assert lines.captions == dict.fromkeys(blank, "0 lines matched, 0 segments found")
