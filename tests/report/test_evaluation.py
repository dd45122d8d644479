"""Evaluations as text, and lines that carry their cameras' errors."""

import jax
import numpy as np
import pytest

import trinoc
from simulation import loose_segments
from trinoc.errors import InputError
from trinoc.evaluation.evaluation import evaluate
from trinoc.evaluation.known_shape import KnownShape
from trinoc.evaluation.lines_of_rig import lines_of_form, lines_of_rig
from trinoc.geometry.rig import PARAMETER_NAMES, Rig
from trinoc.match import join_collinear
from trinoc.match.tracks.matches import Matches
from trinoc.report import evaluation_text
from trinoc.synth import table1_lens, table1_rig
from trinoc.synth.rigs import TABLE_1

VIEWS = tuple(TABLE_1)
SIGMA_PX = 0.1
# The sigmas of a poor sheet: the cameras' errors are then larger than the segments' own.
SIGMA = np.tile([0.05, 0.05, 0.05, 0.5], 3)
NAMES = [f"{view}.{name}" for view in VIEWS for name in PARAMETER_NAMES[:4]]
EDGES = loose_segments(4, count=64, reach_mm=40.0).edges_mm


def triangulated(matrices_px, uv_px, visible, sigma_px):
    """Least-squares points (n, 3) of their images (n, v, 2), and their covariance."""
    points, weight = np.zeros((len(uv_px), 3)), visible[:, :, None, None] / sigma_px**2
    for _ in range(6):
        image = np.einsum("vij,nj->nvi", matrices_px[:, :, :3], points) + matrices_px[:, :, 3]
        projected_px = image[..., :2] / image[..., 2:]
        jacobian = matrices_px[:, :2, :3] - projected_px[..., None] * matrices_px[:, 2:, :3]
        jacobian = jacobian / image[..., 2:, None]
        normal = np.einsum("nvki,nvkj->nij", weight * jacobian, jacobian)
        gradient = np.einsum("nvki,nvk->ni", weight * jacobian, projected_px - uv_px)
        points = points - np.linalg.solve(normal, gradient[..., None])[..., 0]
    return points, np.linalg.inv(normal)


def rig_off_by(change=None):
    """Table 1's rig with its parameters changed, and the covariance of such changes."""
    change = np.zeros(12) if change is None else change
    rows = np.array([TABLE_1[view] for view in VIEWS]) + change.reshape(3, 4)
    camera = trinoc.Camera.from_degrees
    cameras = {
        view: camera(table1_lens(), pan_deg=p, tilt_deg=t, swing_deg=s, distance_mm=d)
        for view, (p, t, s, d) in zip(VIEWS, rows.tolist(), strict=True)
    }
    return Rig(cameras, parameters=NAMES, covariance=np.diag(SIGMA**2))


def made_matches(rig, *, seed=0, sigma_px=SIGMA_PX):
    """Matches of the edges, triangulated with `rig` from images of the true rig."""
    generator = np.random.default_rng(seed)
    points = np.concatenate([EDGES, np.ones((*EDGES.shape[:2], 1))], axis=2)
    images = np.einsum("vij,tej->tvei", table1_rig().matrices_px, points)
    fragments = images[..., :2] / images[..., 2:]
    fragments = fragments + sigma_px * generator.normal(size=fragments.shape)
    count = len(EDGES)
    covariance = np.tile(sigma_px**2 * np.eye(4), (count, 3, 1, 1))
    visible = np.ones((count, 3), dtype=bool)
    visible[::4, 2] = False
    ends = np.swapaxes(fragments, 1, 2).reshape(-1, 3, 2)
    points, point_covariance = triangulated(
        rig.matrices_px, ends, np.repeat(visible, 2, axis=0), sigma_px
    )
    end_covariances = np.zeros((count, 6, 6))
    end_covariances[:, :3, :3], end_covariances[:, 3:, 3:] = (
        point_covariance[::2],
        point_covariance[1::2],
    )
    index = np.where(visible, np.arange(count)[:, None], -1)
    hidden = ~visible[:, :, None, None]
    return Matches(
        VIEWS,
        index,
        np.where(hidden, np.nan, fragments),
        points.reshape(-1, 2, 3),
        end_covariances,
        np.where(visible.all(axis=1), "trinocular", "binocular"),
        np.linspace(0.3, 1.0, count),
        np.zeros(count),
        {view: np.full(count, "matched") for view in VIEWS},
        {},
        np.where(hidden, np.nan, covariance),
    )


def test_lines_follow_their_cameras_as_triangulation_does():
    rig = rig_off_by()
    lines = lines_of_rig(made_matches(rig), rig)
    for parameter, step in ((0, 1e-3), (3, 1e-3), (9, 1e-3)):
        change = np.zeros(12)
        change[parameter] = step
        there, here = (made_matches(rig_off_by(sign * change)).lines_mm for sign in (1, -1))
        numeric = (there - here).reshape(-1, 6) / (2 * step)
        along = EDGES[:, 1] - EDGES[:, 0]
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        across = np.eye(3) - along[:, :, None] * along[:, None, :]
        difference = (lines.by_parameters[:, :, parameter] - numeric).reshape(-1, 2, 3)
        offsets_mm = np.einsum("tij,tej->tei", across, difference)
        assert np.abs(offsets_mm).max() < 0.02 * np.abs(numeric).max()


def test_errors_of_the_cameras_are_in_the_normalised_errors():
    generator = np.random.default_rng(9)
    track_variances, line_variances = [], []
    for seed in range(12):
        rig = rig_off_by(SIGMA * generator.normal(size=12))
        matches = made_matches(rig, seed=seed)
        lines = lines_of_rig(matches, rig)
        track_variances.append(evaluate(matches, EDGES, tolerances_mm=(5.0,)).normalised.variance)
        line_variances.append(evaluate(lines, EDGES, tolerances_mm=(5.0,)).normalised.variance)
    assert np.mean(track_variances) > 2
    # Cameras have twelve errors, which all lines share, 12 times.
    assert np.mean(line_variances) == pytest.approx(1.0, abs=4 * np.sqrt(2 / (12 * 12)))


def test_a_line_of_one_track_follows_the_cameras_as_the_track_does():
    rig = rig_off_by()
    matches = made_matches(rig)
    tracks = lines_of_rig(matches, rig)
    joined = join_collinear(matches, rig)
    lines = lines_of_form(matches, rig, "joined")
    alone = np.flatnonzero(joined.pieces == 1)
    track_of_line = np.array([joined.tracks_of(line)[0] for line in alone])
    assert len(alone) > 50
    # It is weighed anew among errors of several sizes, and moves across itself a little.
    moved = lines.ends_mm[alone] - tracks.ends_mm[track_of_line]
    directions = tracks.ends_mm[track_of_line, 1] - tracks.ends_mm[track_of_line, 0]
    np.testing.assert_allclose((moved @ directions[:, :, None])[..., 0], 0.0, atol=1e-6)
    sigma = np.sqrt(np.trace(lines.fragment_covariance_mm2[alone], axis1=1, axis2=2))
    assert (np.linalg.norm(moved, axis=(1, 2)) < sigma).all()
    np.testing.assert_allclose(
        lines.by_parameters[alone], tracks.by_parameters[track_of_line], atol=1e-9
    )
    assert 0 < len(lines_of_form(matches, rig, "corners")) <= len(matches)


def test_cameras_without_a_view_change_nothing():
    rig = rig_off_by()
    matches, more = made_matches(rig), {f"camera {k}": rig.cameras[0] for k in range(3)}
    larger = Rig(
        {**more, **dict(rig.items())}, parameters=rig.parameters, covariance=rig.covariance
    )
    for form in ("tracks", "joined", "wireframe"):
        expected, lines = (lines_of_form(matches, each, form) for each in (rig, larger))
        assert expected.by_parameters.any()
        jax.tree.map(np.testing.assert_array_equal, lines, expected)


def test_a_rig_without_covariance_counts_as_exact():
    matches = made_matches(table1_rig())
    lines = lines_of_rig(matches, table1_rig())
    np.testing.assert_array_equal(lines.covariance_mm2, matches.covariance_mm2)
    with pytest.raises(InputError, match='no camera "left"'):
        lines_of_rig(matches, Rig({"upper": table1_rig()["upper"]}))


def test_the_text_has_the_shares_and_the_motion():
    matches, shape = made_matches(table1_rig()), KnownShape.of_edges(EDGES)
    evaluation = evaluate(matches, shape)
    text = evaluation_text(evaluation)
    head, precision, completeness, *_ = text.splitlines()
    assert head.split() == ["within", "(mm)", "0.1", "0.25", "0.5", "1"]
    for line, shares in (
        (precision, evaluation.precision),
        (completeness, evaluation.completeness),
    ):
        assert line.split()[1:] == [f"{share:.3f}" for share in shares]
    assert "wanted: every edge" in text
    assert "after laying" not in text
    parallel = np.array([[[0.0, y, 0.0], [50.0, y, 0.0]] for y in (0.0, 20.0, 40.0)])
    text = evaluation_text(evaluate(parallel + 0.5, parallel, aligned=True))
    assert "shifted by (0.000 \N{MINUS SIGN}0.500" in text.replace("-0.500", "\N{MINUS SIGN}0.500")
    assert "do not determine a part of this motion" in text
    assert "-" in evaluation_text(evaluate(np.zeros((0, 2, 3)), EDGES))
