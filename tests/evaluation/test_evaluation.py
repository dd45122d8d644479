"""Laws of the numbers that evaluate lines against known edges."""

import dataclasses
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from simulation import loose_segments
from simulation.scenes import Scene
from simulation.solids import box
from trinoc.errors import InputError
from trinoc.evaluation.alignment import RigidMotion, align
from trinoc.evaluation.evaluation import EvaluationStatus, evaluate
from trinoc.evaluation.known_shape import KnownShape
from trinoc.evaluation.lines_of_rig import independent_lines
from trinoc.evaluation.lines_on_edges import offsets_across
from trinoc.evaluation.normalised_errors import normalised_errors
from trinoc.geometry import UncertainLines
from trinoc.synth import table1_rig
from trinoc.synth.truth import SceneTruth, SeenParts

SEEDS = st.integers(0, 10_000)
BOX = box((52.0, 36.0, 30.0))
EDGES = Scene.of_solids((BOX,)).edges_mm
# What the numbers of a record may differ by when millimetres were only rounded.
CLOSE = {"rel": 1e-5, "abs": 1e-5, "nan_ok": True}


def noisy(generator, edges_mm=EDGES, *, sigma_mm=0.05):
    """Lines near edges, some short or far from every edge, with a placeholder covariance."""
    lines = edges_mm + sigma_mm * generator.normal(size=edges_mm.shape)
    lines[::3, 1] = 0.5 * (lines[::3, 0] + lines[::3, 1])
    stray = generator.uniform(-60, 60, (4, 2, 3))
    lines = np.concatenate([lines, stray])
    root = generator.normal(size=(len(lines), 6, 6)) * sigma_mm
    return independent_lines(lines, root @ root.mT)


def moved(generator):
    """A rigid motion, as a function of points."""
    turn = Rotation.from_quat(generator.normal(size=4))
    shift = generator.uniform(-100, 100, 3)
    return turn.as_matrix(), shift


def assert_same(first, second):
    for name, number in first.items():
        assert second[name] == pytest.approx(number, **CLOSE), name


def test_perfect_lines_have_no_error_and_miss_nothing():
    report = evaluate(EDGES, EDGES)
    assert report.status is EvaluationStatus.COMPARED
    assert report.precision == report.completeness == (1.0,) * 4
    assert report.distance_mm.at_95 < 1e-5
    assert report.angle_deg.at_95 < 1e-9
    np.testing.assert_array_equal(report.lines, np.arange(len(EDGES)))


@settings(max_examples=20)
@given(seed=SEEDS)
def test_a_motion_of_both_changes_nothing(seed):
    generator = np.random.default_rng(seed)
    lines = noisy(generator)
    rotation, shift = moved(generator)
    both = np.kron(np.eye(2), rotation)
    elsewhere = independent_lines(
        lines.ends_mm @ rotation.T + shift, both @ lines.fragment_covariance_mm2 @ both.T
    )
    there = evaluate(elsewhere, EDGES @ rotation.T + shift)
    assert_same(evaluate(lines, EDGES).record(), there.record())


@settings(max_examples=20)
@given(seed=SEEDS)
def test_order_of_lines_and_of_their_ends_changes_nothing(seed):
    generator = np.random.default_rng(seed)
    lines = noisy(generator)
    order = generator.permutation(len(lines))
    turned = generator.random(len(lines)) < 0.5
    ends, covariance = lines.ends_mm.copy(), lines.fragment_covariance_mm2.copy()
    ends[turned] = ends[turned, ::-1]
    swap = np.roll(np.arange(6), 3)
    covariance[turned] = covariance[turned][:, swap][:, :, swap]
    reordered = evaluate(independent_lines(ends[order], covariance[order]), EDGES)
    assert_same(evaluate(lines, EDGES).record(), reordered.record())


@settings(max_examples=20)
@given(seed=SEEDS, share=st.floats(0.1, 0.9))
def test_lines_in_two_pieces_are_as_right_and_as_complete(seed, share):
    ends = noisy(np.random.default_rng(seed)).ends_mm
    cut = ends[:, :1] + share * (ends[:, 1:] - ends[:, :1])
    pieces = np.concatenate(
        [np.concatenate([ends[:, :1], cut], 1), np.concatenate([cut, ends[:, 1:]], 1)]
    )
    unsplit, split = evaluate(ends, EDGES), evaluate(pieces, EDGES)
    # Pieces are sampled at other points, every quarter of a millimetre.
    tolerance = 0.25 * 2 * len(pieces) / unsplit.length_put_out_mm
    assert split.length_put_out_mm == pytest.approx(unsplit.length_put_out_mm)
    np.testing.assert_allclose(split.precision, unsplit.precision, atol=tolerance)
    np.testing.assert_allclose(split.completeness, unsplit.completeness, atol=1e-12)


def test_precision_and_completeness_by_hand():
    edge = np.array([[[0.0, 0.0, 0.0], [40.0, 0.0, 0.0]]])
    line = np.array([[[0.5, 0.09, 0.0], [39.8, 0.09, 0.0]]])
    report = evaluate(line, edge)
    assert report.precision == (1.0, 1.0, 1.0, 1.0)
    assert report.distance_mm.median == pytest.approx(0.09, abs=1e-6)
    # Half a millimetre at one end and 0.2 at the other are further than 0.1 mm from the line.
    assert report.completeness[0] == pytest.approx(39.3 / 40, abs=0.01)


def test_lines_that_run_past_an_edge_or_away_from_it():
    edge = np.array([[[0.0, 0.0, 0.0], [40.0, 0.0, 0.0]]])
    past = evaluate(np.array([[[-10.0, 0.0, 0.0], [18.0, 0.0, 0.0]]]), edge)
    assert past.lines[0] == 0
    away = evaluate(np.array([[[0.0, 0.0, 0.0], [40.0, 0.0, 8.0]]]), edge)
    assert away.lines[0] == -1
    assert away.normalised.lines == 0
    across = evaluate(np.array([[[20.0, -0.4, 0.0], [20.0, 0.4, 0.0]]]), edge)
    assert across.lines[0] == -1


def test_the_error_of_the_cameras_by_hand():
    edge = np.array([[[0.0, 0.0, 0.0], [40.0, 0.0, 0.0]]])
    line = np.array([[[2.0, 0.1, 0.0], [38.0, 0.1, 0.0]]])
    fragment_covariance, by_parameters = (
        0.01 * np.eye(6)[None],
        np.array([0.0, 1, 0, 0, 1, 0]).reshape(1, 6, 1),
    )
    # Both ends are off by one sigma of their own: two of four squares are 1.
    alone = evaluate(independent_lines(line, fragment_covariance), edge).normalised
    assert alone.variance == pytest.approx(0.5)
    # Their mean has the variance 0.005 + 0.03, and is off by 0.1.
    both = evaluate(
        UncertainLines(line, fragment_covariance, by_parameters, np.array([[0.03]])), edge
    ).normalised
    assert both.variance == pytest.approx(0.01 / 0.035 / 4)


def test_errors_as_large_as_claimed_have_normalised_variance_one():
    generator = np.random.default_rng(5)
    edges = loose_segments(1, count=2000).edges_mm
    count = len(edges)
    root = 0.02 * generator.normal(size=(count, 6, 6))
    by_parameters = 0.03 * generator.normal(size=(count, 6, 5))
    spread = generator.normal(size=(5, 5))
    own_error = (root @ generator.normal(size=(count, 6, 1))).reshape(-1, 2, 3)
    shared_error = (by_parameters @ spread @ generator.normal(size=5)).reshape(-1, 2, 3)
    four_sigmas = 4 * np.sqrt(2 / (4 * count))

    def errors(ends_mm, parameter_covariance):
        lines = UncertainLines(ends_mm, root @ root.mT, by_parameters, parameter_covariance)
        return normalised_errors(offsets_across(lines, edges), parameter_covariance)

    alone = errors(edges + own_error, np.zeros((5, 5)))
    assert alone.lines == count
    assert alone.variance == pytest.approx(1.0, abs=four_sigmas)
    assert alone.spread == pytest.approx(1.0, abs=four_sigmas)
    assert alone.share_within == pytest.approx(0.95, abs=0.012)
    assert alone.share_of_lines == pytest.approx(0.95, abs=0.025)
    # What all lines share does not average out over them: five numbers determine it.
    together = errors(edges + own_error + shared_error, spread @ spread.T)
    assert together.variance == pytest.approx(1.0, abs=2.0)
    assert (
        errors(edges + own_error + shared_error, np.zeros((5, 5))).variance > 2 * together.variance
    )


def test_a_covariance_four_times_too_small_shows():
    generator = np.random.default_rng(6)
    lines = EDGES + 0.05 * generator.normal(size=(100, *EDGES.shape))
    reported_covariance = np.tile(0.025**2 * np.eye(6), (100 * len(EDGES), 1, 1))
    report = evaluate(independent_lines(lines.reshape(-1, 2, 3), reported_covariance), EDGES)
    assert report.normalised.variance == pytest.approx(4.0, rel=0.1)
    assert report.normalised.spread == pytest.approx(2.0, rel=0.05)


def test_ends_unknown_along_the_line_do_not_enter():
    line = np.array([[[0.0, 0.1, 0.0], [30.0, 0.1, 0.0]]])
    edge = np.array([[[0.0, 0.0, 0.0], [40.0, 0.0, 0.0]]])
    errors = [
        evaluate(independent_lines(line, np.diag([along, 0.01, 0.01] * 2)[None]), edge).normalised
        for along in (0.01, 1e6)
    ]
    assert errors[0] == errors[1]
    assert errors[0].variance == pytest.approx(0.5)


@settings(max_examples=8)
@given(seed=SEEDS, turn_deg=st.floats(-20, 20), shift_mm=st.floats(0, 7))
def test_alignment_recovers_a_motion(seed, turn_deg, shift_mm):
    generator = np.random.default_rng(seed)
    axis = generator.normal(size=3)
    rotation = Rotation.from_rotvec(np.radians(turn_deg) * axis / np.linalg.norm(axis)).as_matrix()
    shift = generator.normal(size=3)
    shift = shift_mm * shift / np.linalg.norm(shift)
    lines = np.concatenate([EDGES, generator.uniform(-60, 60, (2, 2, 3))])
    elsewhere = (lines - shift) @ rotation
    motion = align(elsewhere, EDGES)
    assert motion.rank == 6
    np.testing.assert_allclose(motion.rotation, rotation, atol=1e-5)
    np.testing.assert_allclose(motion.shift_mm, shift, atol=1e-3)
    report = evaluate(elsewhere[: len(EDGES)], EDGES, aligned=True)
    assert report.motion is not None
    assert report.motion.turn_deg == pytest.approx(abs(turn_deg), abs=1e-3)
    assert report.precision[0] == 1.0


def test_what_edges_leave_free_does_not_move():
    edges = np.array([[[0.0, y, z], [50.0, y, z]] for y in (0.0, 20.0) for z in (0.0, 15.0)])
    motion = align(edges + np.array([3.0, 0.5, -0.4]), edges)
    assert motion.rank == 5
    np.testing.assert_allclose(motion.shift_mm, [0.0, -0.5, 0.4], atol=1e-6)


def test_nothing_to_compare_is_said():
    none = np.zeros((0, 2, 3))
    far = EDGES + 500.0
    for lines, edges, status in (
        (none, EDGES, EvaluationStatus.NO_LINES),
        (EDGES, none, EvaluationStatus.NO_EDGES),
        (far, EDGES, EvaluationStatus.NOTHING_NEAR),
    ):
        report = evaluate(lines, edges, aligned=False)
        assert report.status is status
        assert report.precision == report.completeness == (0.0,) * 4
        assert report.normalised.lines == 0
        assert np.isnan(report.normalised.variance)
        assert report.status.value.endswith(".")
    assert evaluate(none, EDGES, aligned=True).motion is None


@pytest.mark.parametrize("tolerances", [(), (0.0, 1.0)])
def test_tolerances_must_be_positive(tolerances):
    with pytest.raises(InputError, match="positive distances"):
        evaluate(EDGES, EDGES, tolerances_mm=tolerances)


@pytest.mark.parametrize("wrong", ["lines", "edges"])
def test_numbers_must_be_finite(wrong):
    bad = EDGES.copy()
    bad[3, 1, 2] = np.nan
    with pytest.raises(InputError, match="not finite"):
        evaluate(bad if wrong == "lines" else EDGES, bad if wrong == "edges" else EDGES)


def test_another_covariance_is_refused():
    class Corners(NamedTuple):
        lines_mm: np.ndarray
        covariance_mm2: np.ndarray

    with pytest.raises(InputError, match="covariance has shape"):
        evaluate(Corners(EDGES, np.zeros((5, 3, 3))), EDGES)


def test_a_scene_wants_what_two_pictures_show():
    full_parts = SeenParts(
        np.array([0, 1]), np.array([[0.0, 1.0], [0.0, 0.5]]), np.array([20.0, -30.0])
    )
    faint_parts = dataclasses.replace(full_parts, grey_step=np.array([20.0, 3.0]))
    truth = SceneTruth(
        EDGES[:3], ("edge", "edge", "rim"), {"a": full_parts, "b": full_parts, "c": faint_parts}
    )
    shape = KnownShape.of_scene(truth)
    np.testing.assert_array_equal(shape.wanted_edge, [0, 1])
    np.testing.assert_allclose(shape.wanted_mm[1], [EDGES[1, 0], EDGES[1].mean(axis=0)])
    report = evaluate(EDGES[:3], truth)
    assert report.completeness == report.precision == (1.0,) * 4
    only = {"a": full_parts, "c": faint_parts}
    fewer = KnownShape.of_scene(SceneTruth(EDGES[:3], ("edge", "edge", "rim"), only))
    np.testing.assert_array_equal(fewer.wanted_edge, [0])


def test_faces_hide_edges_from_the_cameras(monkeypatch):
    rig = table1_rig()
    bare = KnownShape.of_edges(EDGES).visible_to(rig)
    solid = KnownShape.of_edges(EDGES, BOX.triangles_mm).visible_to(rig)
    assert len(bare.wanted_edge) == len(EDGES)
    # All cameras stand before and above: the four bottom and upright edges at the back are hidden.
    hidden = set(range(len(EDGES))) - set(solid.wanted_edge.tolist())
    behind = {
        i for i, edge in enumerate(EDGES)
        if edge[:, 1].min() == EDGES[..., 1].max() and edge[:, 2].min() == EDGES[..., 2].min()
    }  # fmt: skip
    assert behind
    assert behind <= hidden
    # However many edges are looked at in one go.
    monkeypatch.setattr("trinoc.evaluation.known_shape._PAIRS_PER_BLOCK", 40)
    in_blocks = KnownShape.of_edges(EDGES, BOX.triangles_mm).visible_to(rig)
    np.testing.assert_array_equal(in_blocks.wanted_edge, solid.wanted_edge)
    np.testing.assert_array_equal(in_blocks.wanted_extent, solid.wanted_extent)


def test_a_motion_carries_covariance_and_derivatives_as_it_carries_points() -> None:
    generator = np.random.default_rng(5)
    motion = RigidMotion(*moved(generator), 6)
    root, by = generator.normal(size=(2, 6, 6)), generator.normal(size=(2, 6, 3))
    lines = UncertainLines(generator.normal(size=(2, 2, 3)), root @ root.mT, by, np.eye(3))
    carried = motion.move_lines(lines)
    # The motion of both ends is affine: its columns are what unit steps become.
    steps = np.concatenate([np.zeros((1, 2, 3)), np.eye(6).reshape(6, 2, 3)])
    images = motion.move_points(steps).reshape(7, 6)
    linear = (images[1:] - images[0]).T
    expected = np.array(
        [linear @ covariance @ linear.T for covariance in lines.fragment_covariance_mm2]
    )
    np.testing.assert_allclose(carried.fragment_covariance_mm2, expected)
    np.testing.assert_allclose(
        carried.by_parameters, np.array([linear @ derivative for derivative in by])
    )
