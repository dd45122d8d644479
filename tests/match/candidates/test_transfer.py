"""The prediction of a pair in a third view agrees with the image of its line, within its sigmas."""

import jax
import numpy as np

from tests.match.scene import MadeScene, image_px
from trinoc.match.candidates.third_view import Prediction, predict, third_view
from trinoc.match.observations.table import SegmentTable
from trinoc.match.two_view.epipolar_pencil import build_pencil, take_segments

FIRST, SECOND, THIRD = 0, 1, 2


@jax.jit
def predictions(lines: SegmentTable, ends_px, pairs) -> Prediction:
    """Predictions in view 2 by pairs of views 0 and 1, with the ends of all segments replaced."""
    lines = lines._replace(ends_px=ends_px)
    planes = build_pencil(lines, np.array(FIRST), np.array(SECOND))
    view = third_view(lines, planes, np.array(THIRD))

    def one(pair):
        rows = take_segments(planes.first, pair[0]), take_segments(planes.second, pair[1])
        return predict(view, *rows)

    return jax.vmap(one)(pairs)


def predicted(scene: MadeScene, ends_px: np.ndarray) -> Prediction:
    pairs = np.ascontiguousarray(scene.true[:, [FIRST, SECOND]])
    return jax.tree.map(np.asarray, predictions(scene.inputs.lines, ends_px, pairs))


def test_exact_pairs_predict_the_image_of_their_line(exact: MadeScene) -> None:
    prediction = predicted(exact, exact.table.ends_px)
    ends = np.stack([prediction.u0, prediction.v0, prediction.u1, prediction.v1], axis=1).reshape(
        -1, 2, 2
    )
    truth = image_px(exact.table.matrix_px[THIRD], exact.lines_mm)
    swap = np.abs(ends - truth).max((1, 2)) > 1.0
    ends = np.where(swap[:, None, None], ends[:, ::-1], ends)
    np.testing.assert_allclose(ends, truth, atol=1e-7)


def test_noisy_pairs_scatter_across_the_image_as_stated(exact: MadeScene) -> None:
    rng, table = np.random.default_rng(4), exact.table
    stated = predicted(exact, table.ends_px)
    exact_ends = np.stack([stated.u0, stated.v0, stated.u1, stated.v1], axis=1).reshape(-1, 2, 2)
    direction = exact_ends[:, 1] - exact_ends[:, 0]
    normal = (
        np.stack([-direction[:, 1], direction[:, 0]], axis=1)
        / np.linalg.norm(direction, axis=1)[:, None]
    )
    sigma = np.sqrt(np.einsum("vnee->vne", table.across_px2))
    # A tenth of the stated errors, at which the projection is as good as linear.
    scale, errors = 0.1, []
    for _ in range(300):
        noise = scale * sigma * rng.normal(size=sigma.shape)
        moved = predicted(exact, table.ends_px + noise[..., None] * table.line[:, :, None, :2])
        ends = np.stack([moved.u0, moved.v0, moved.u1, moved.v1], axis=1).reshape(-1, 2, 2)
        errors.append(((ends - exact_ends) * normal[:, None]).sum(-1) / scale)
    errors = np.array(errors)
    covariance = np.stack([stated.c00, stated.c01, stated.c01, stated.c11], axis=1)
    covariance = covariance.reshape(-1, 2, 2)
    assert stated.possible.sum() >= 5
    is_precise = np.sqrt(stated.c00 + stated.c11) < 6.0
    square = np.einsum("kni,nij,knj->kn", errors, np.linalg.inv(covariance), errors)[:, is_precise]
    assert abs(square.mean() - 2) < 4 * 2 / np.sqrt(square.size)
    correlation = np.einsum("kni,knj->nij", errors, errors)[is_precise] / len(errors)
    scatter = covariance[is_precise] / np.sqrt(
        stated.c00[is_precise, None, None] * stated.c11[is_precise, None, None]
    )
    measured = correlation / np.sqrt(stated.c00 * stated.c11)[is_precise, None, None]
    size = np.maximum(np.abs(scatter), 1.0)
    np.testing.assert_allclose(measured / size, scatter / size, atol=5 * np.sqrt(2 / len(errors)))
