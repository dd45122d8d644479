"""The part of a line that two views show, computed from known parts."""

import numpy as np

from tests.match.made import pictures
from tests.match.scene import MadeScene, image_px, place_on, seen_by
from trinoc.match.tracks.line_fit import (
    line_end_positions,
    points_on_lines,
    segment_extents,
    two_view_span,
)


def test_lines_reach_as_far_as_the_second_furthest_view(exact: MadeScene) -> None:
    rng, rig, lines_mm = np.random.default_rng(9), exact.rig, exact.lines_mm
    # Every view shows the middle, and another part on either side of it.
    share = np.sort(
        np.stack([rng.uniform(0, 0.3, (3, 30)), rng.uniform(0.7, 1, (3, 30))], axis=2), axis=2
    )
    shown = {
        name: pictures(rig, points_on_lines(lines_mm, share[v]))[name]
        for v, name in enumerate(rig.names)
    }
    scene = seen_by(rig, lines_mm, shown, 0.3)
    turn = [rig.names.index(name) for name in scene.inputs.names]
    index = scene.true.copy()
    # A part of the lines is seen in two views.
    index[20:, 1] = -1
    by_view = np.where((index >= 0).T[..., None], share[turn], np.nan)
    # NaN sorts last.
    begin = np.sort(by_view[..., 0], axis=0)[1]
    end = -np.sort(-by_view[..., 1], axis=0)[1]
    expected_mm = points_on_lines(lines_mm, np.stack([begin, end], axis=1))
    common_mm = points_on_lines(
        lines_mm, np.stack([np.nanmax(by_view[..., 0], 0), np.nanmin(by_view[..., 1], 0)], axis=1)
    )
    for ends_mm, expected in ((common_mm, expected_mm), (common_mm[:, ::-1], expected_mm[:, ::-1])):
        span = two_view_span(segment_extents(scene.inputs, index, ends_mm))
        positions = line_end_positions(scene.inputs, index, points_on_lines(ends_mm, span))
        for view in range(3):
            on = index[:, view] >= 0
            image = image_px(scene.table.matrix_px[view], expected[on])
            image_positions = place_on(scene.table.ends_px[view, index[on, view]], image)
            np.testing.assert_allclose(positions[on, view], image_positions, atol=1e-7)
