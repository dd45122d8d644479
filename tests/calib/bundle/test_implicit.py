"""Derivatives of refined cameras and lines agree with differences of whole refinements."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.calib.bundle.made_tracks import SHEET_SIGMA, TRUTH, made_tracks, rig_at
from trinoc.calib import refine_differentiably
from trinoc.calib.bundle.camera import camera_state, stack_states
from trinoc.calib.bundle.factors import PosePrior
from trinoc.calib.bundle.joint_problem import FragmentTable
from trinoc.geometry.pose import PoseModel
from trinoc.numerics.robust_loss import GemanMcClure

LOSS = GemanMcClure.from_scale(8.0)


def crossing(line, ends):
    """Intersection of a line with the plane through a segment's second end, normal to the segment.

    The anchors themselves may slide along the line, which is no property of the line.
    """
    normal = ends[1] - ends[0]
    along = line[1] - line[0]
    return line[0] + (normal @ (ends[1] - line[0])) / (normal @ along) * along


@pytest.mark.slow
def test_gradients_of_a_line_and_of_a_camera_agree_with_differences():
    lines, ends, _ = made_tracks(0, 12, hidden=0.0)
    rig = rig_at(TRUTH, with_covariance=True)
    cameras = stack_states([camera_state(c, PoseModel.AIMED) for c in rig.cameras])
    prior = PosePrior(TRUTH.reshape(3, 4), np.diag(SHEET_SIGMA**-2), cameras)

    def outputs(fragments_px, sheet_values):
        tracks = FragmentTable(fragments_px, lines.covariance_px2, lines.seen)
        sheet = PosePrior(sheet_values, prior.information, cameras)
        answer, anchors = refine_differentiably(cameras, lines.lines_mm, tracks, sheet, LOSS)
        upper, start = (jax.tree.map(lambda leaf: leaf[0], each) for each in (answer, cameras))
        return jnp.stack([upper.parameters(start)[1], crossing(anchors[4], ends[4])[2]])

    # One program serves values and gradients: compiling it takes most of the time.
    @eqx.filter_jit
    def value_and_gradients(fragments_px, sheet_values, weight):
        value, pull_back = jax.vjp(outputs, fragments_px, sheet_values)
        return value, pull_back(weight)

    def value(fragments_px, sheet_values):
        return value_and_gradients(fragments_px, sheet_values, np.zeros(2))[0]

    here = (lines.fragments_px, prior.values)
    rows = [value_and_gradients(*here, weight)[1] for weight in np.eye(2)]
    by_fragments, by_sheet = (np.stack(each) for each in zip(*rows, strict=True))
    step_px, step = 1e-3, 1e-4
    for track, view, end, axis in ((4, 0, 1, 0), (4, 2, 0, 1), (7, 1, 1, 1)):
        delta = np.zeros(lines.fragments_px.shape)
        delta[track, view, end, axis] = step_px
        above = value(lines.fragments_px + delta, prior.values)
        below = value(lines.fragments_px - delta, prior.values)
        expected = (above - below) / (2 * step_px)
        derivative = by_fragments[:, track, view, end, axis]
        np.testing.assert_allclose(derivative, expected, rtol=1e-4, atol=1e-7)
    for view, parameter in ((0, 1), (2, 3)):
        delta = np.zeros((3, 4))
        delta[view, parameter] = step
        above = value(lines.fragments_px, prior.values + delta)
        below = value(lines.fragments_px, prior.values - delta)
        expected = (above - below) / (2 * step)
        np.testing.assert_allclose(by_sheet[:, view, parameter], expected, rtol=1e-4, atol=1e-7)
