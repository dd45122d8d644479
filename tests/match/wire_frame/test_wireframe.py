"""Wire frame of a known solid, from exact and from noisy lines."""

import dataclasses
from collections import Counter

import numpy as np
import pytest
from scipy.stats import chi2

from simulation.solids import Polyhedron, box
from tests.match.line_map.test_joined import AS_STATED, VIEWS, tracks_of
from tests.match.made import rig_of
from trinoc.errors import InputError
from trinoc.geometry.rig import Rig
from trinoc.match import Wireframe, wireframe
from trinoc.match.tracks.matches import Matches

CUBE = box((40.0, 40.0, 40.0)).place(turn_deg=27.0, shift_mm=np.array([3.0, -4.0, 0.0]))


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_of(*VIEWS)


def frame_of(
    rig: Rig, solid: Polyhedron = CUBE, *, sigma_px: float = 0.2, seed: int | None = None, **options
) -> Wireframe:
    matches = tracks_of(rig, solid.edges_mm, sigma_px=sigma_px, seed=seed)
    return wireframe(matches, rig, tuning=AS_STATED, **options)


def corner_errors(frame: Wireframe, true_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(errors, squared Mahalanobis distances) of all vertices from the nearest true ones."""
    distance = np.linalg.norm(frame.vertices_mm[:, None] - true_mm, axis=2)
    error = frame.vertices_mm - true_mm[distance.argmin(axis=1)]
    solved = np.linalg.solve(frame.vertices_covariance_mm2, error[:, :, None])[..., 0]
    return error, (error * solved).sum(axis=1)


@pytest.mark.parametrize("seed", [None, 1, 2])
def test_a_cube_has_eight_corners_twelve_edges_and_six_faces(rig, seed) -> None:
    frame = frame_of(rig, seed=seed)
    assert len(frame.vertices_mm) == frame.corner.sum() == 8
    assert len(frame) == 12
    assert sorted(map(len, frame.faces)) == [4] * 6
    # Every edge borders two faces, which run along it in opposite directions.
    directed_edges = Counter(
        (a, b)
        for f in frame.faces
        for a, b in zip(f.tolist(), np.roll(f, -1).tolist(), strict=True)
    )
    assert {tuple(sorted(edge)) for edge in directed_edges} == {
        tuple(pair) for pair in frame.edges.tolist()
    }
    assert len(frame.let_go) == 0
    assert frame.checked.all()
    error, _ = corner_errors(frame, CUBE.vertices_mm)
    assert np.abs(error).max() < (1e-6 if seed is None else 0.5)


def test_faces_are_planes_and_turn_to_the_cameras_that_see_them(rig) -> None:
    frame = frame_of(rig, seed=3)
    assert frame.facing.sum() >= 5  # the base lies below all cameras
    for face, loop in enumerate(frame.faces):
        normal, offset = frame.planes[face, :3], frame.planes[face, 3]
        np.testing.assert_allclose(frame.vertices_mm[loop] @ normal, offset, atol=1e-6)
        centre = frame.vertices_mm[loop].mean(axis=0)
        spokes = frame.vertices_mm[loop] - centre
        turn = np.cross(spokes, np.roll(spokes, -1, axis=0)) @ normal
        assert (turn > 0).all()
        sides = np.array([rig[name].centre_world_mm @ normal - offset for name in VIEWS])
        assert (sides > 0).all() == frame.facing[face]
    loose = frame_of(rig, seed=3, flat=False)
    off = [
        np.ptp(loose.vertices_mm[loop] @ loose.planes[f, :3]) for f, loop in enumerate(loose.faces)
    ]
    assert max(off) > 1e-3


@pytest.mark.parametrize("field", ["viewpoint_dependent", "silhouette"])
def test_an_edge_whose_track_is_no_line_in_space_is_marked(rig, field) -> None:
    matches = tracks_of(rig, CUBE.edges_mm, sigma_px=0.2, seed=1)
    marks = np.zeros(len(matches), dtype=bool)
    marks[4] = True
    if field == "silhouette":
        matches = matches.with_marks(silhouette=np.where(marks, 0.9, 0.1))
    else:
        matches = dataclasses.replace(matches, viewpoint_dependent=marks)
    frame = wireframe(matches, rig, tuning=AS_STATED)
    np.testing.assert_array_equal(
        np.flatnonzero(frame.viewpoint_dependent), [frame.edge_of_track[4]]
    )


def test_planes_and_vertices_are_as_far_off_as_their_covariance_says(rig) -> None:
    corners, planes = [], []
    for seed in range(24):
        frame = frame_of(rig, seed=100 + seed)
        corners.extend(corner_errors(frame, CUBE.vertices_mm)[1])
        for plane, covariance, loop in zip(
            frame.planes, frame.planes_covariance, frame.faces, strict=True
        ):
            nearest = np.linalg.norm(
                frame.vertices_mm[loop][:, None] - CUBE.vertices_mm, axis=2
            ).argmin(axis=1)
            true = np.linalg.svd(np.column_stack([CUBE.vertices_mm[nearest], -np.ones(4)]))[2][3]
            true *= np.sign(true[:3] @ plane[:3]) / np.linalg.norm(true[:3])
            planes.append((plane - true) @ np.linalg.pinv(covariance, 1e-9) @ (plane - true))
    assert len(corners) == 24 * 8
    assert 0.90 < np.mean(np.array(corners) < chi2.ppf(0.95, 3)) < 0.99
    assert 0.8 < np.mean(corners) / 3 < 1.2
    # A plane has three degrees of freedom.
    assert 0.88 < np.mean(np.array(planes) < chi2.ppf(0.95, 3)) < 0.995


def test_what_is_known_together_is_known_better(rig) -> None:
    flat, loose = (frame_of(rig, seed=4, flat=flat) for flat in (True, False))
    flat_traces = [np.trace(block) for block in flat.vertices_covariance_mm2]
    loose_traces = [np.trace(block) for block in loose.vertices_covariance_mm2]
    assert (np.array(flat_traces) < np.array(loose_traces) + 1e-12).all()
    assert flat.joint_covariance_mm2[0].shape == (24, 24)
    # A length is surer than two ends that err apart.
    pair = flat.edges[0]
    joint = flat.covariance_of(pair)
    np.testing.assert_allclose(joint, flat.covariance_mm2[0])
    np.testing.assert_allclose(joint[:3, :3], flat.vertices_covariance_mm2[pair[0]])


def test_the_order_of_tracks_and_their_ends_changes_only_the_numbering(rig) -> None:
    matches = tracks_of(rig, CUBE.edges_mm, sigma_px=0.2, seed=5)
    rank = np.random.default_rng(1).permutation(12)
    fields = {
        name: getattr(matches, name)[rank]
        for name in ("index", "fragments_px", "fragments_covariance_px2", "lines_mm")
    }
    fields["covariance_mm2"] = matches.covariance_mm2[rank]
    reordered = wireframe(dataclasses.replace(matches, **fields), rig, tuning=AS_STATED)
    frame = wireframe(matches, rig, tuning=AS_STATED)
    nearest = np.linalg.norm(frame.vertices_mm[:, None] - reordered.vertices_mm, axis=2)
    to = nearest.argmin(axis=1)
    np.testing.assert_allclose(reordered.vertices_mm[to], frame.vertices_mm, atol=1e-6)
    np.testing.assert_allclose(
        reordered.vertices_covariance_mm2[to], frame.vertices_covariance_mm2, rtol=1e-4, atol=1e-9
    )
    edges = {tuple(sorted(pair)) for pair in to[frame.edges].tolist()}
    assert edges == {tuple(pair) for pair in reordered.edges.tolist()}


def test_a_rigid_motion_of_the_world_moves_the_frame(rig) -> None:
    angle = np.radians(33.0)
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]]
    )
    shift = np.array([12.0, -7.0, 5.0])
    matches = tracks_of(rig, CUBE.edges_mm, sigma_px=0.2, seed=6)
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = turn, shift
    matrices = {name: rig[name].matrix_px @ np.linalg.inv(motion) for name in VIEWS}
    moved_rig = Rig.from_matrices(matrices, image_size_px=rig[VIEWS[0]].image_size_px)
    both = np.kron(np.eye(2), turn)
    moved = dataclasses.replace(
        matches,
        lines_mm=matches.lines_mm @ turn.T + shift,
        covariance_mm2=both @ matches.covariance_mm2 @ both.T,
    )
    frame = wireframe(matches, rig, tuning=AS_STATED)
    there = wireframe(moved, moved_rig, tuning=AS_STATED)
    np.testing.assert_array_equal(there.edges, frame.edges)
    np.testing.assert_allclose(there.vertices_mm, frame.vertices_mm @ turn.T + shift, atol=1e-6)
    np.testing.assert_allclose(
        there.vertices_covariance_mm2,
        turn @ frame.vertices_covariance_mm2 @ turn.T,
        rtol=1e-4,
        atol=1e-9,
    )
    assert {frozenset(f.tolist()) for f in there.faces} == {
        frozenset(f.tolist()) for f in frame.faces
    }


def with_track_moved(matches: Matches, rig: Rig, track: int, line_mm: np.ndarray) -> Matches:
    """The same matches with one track that shows another line."""
    other = tracks_of(rig, line_mm[None], sigma_px=0.2)
    fields = {}
    for name in ("fragments_px", "fragments_covariance_px2", "lines_mm", "covariance_mm2"):
        value = getattr(matches, name).copy()
        value[track] = getattr(other, name)[0]
        fields[name] = value
    return dataclasses.replace(matches, **fields)


def test_a_gross_wrong_edge_is_let_go_and_named(rig) -> None:
    matches = tracks_of(rig, CUBE.edges_mm, sigma_px=0.2, seed=7)
    wrong = 4
    line = CUBE.edges_mm[wrong]
    outward = line.mean(axis=0) - CUBE.vertices_mm.mean(axis=0)
    moved = line + 2.0 * outward / np.linalg.norm(outward)
    frame = wireframe(with_track_moved(matches, rig, wrong, moved), rig, tuning=AS_STATED)
    assert frame.let_go.track.tolist() == [wrong, wrong]
    assert all("chi-square" in reason for reason in frame.let_go.reason)
    # It stays as an edge of its own between free ends; the rest is as it would be without it.
    edge = frame.edge_of_track[wrong]
    assert not frame.corner[frame.edges[edge]].any()
    assert frame.corner.sum() == 8
    assert len(frame.planes) == 4
    corners = frame.vertices_mm[frame.corner]
    distance = np.linalg.norm(corners[:, None] - CUBE.vertices_mm, axis=2)
    assert distance.min(axis=1).max() < 0.6


def test_lines_between_the_same_corners_are_one_edge(rig) -> None:
    lines = np.concatenate([CUBE.edges_mm, CUBE.edges_mm[:1]])
    matches = tracks_of(rig, lines, sigma_px=0.2, seed=8)
    frame = wireframe(matches, rig, tuning=AS_STATED)
    assert len(frame) == 12
    assert frame.edge_of_track[12] == frame.edge_of_track[0]
    assert frame.tracks_of(frame.edge_of_track[0]).tolist() == [0, 12]


def test_of_one_line_and_of_parallel_ones_there_are_edges_and_free_ends(rig) -> None:
    line = np.array([[-20.0, 0.0, 10.0], [25.0, 5.0, 12.0]])
    for lines in (line[None], line + np.array([[[0.0, k, 0.0]] for k in (0.0, 15.0, 30.0)])):
        frame = wireframe(tracks_of(rig, lines, sigma_px=0.2, seed=9), rig)
        assert len(frame) == len(lines)
        assert not frame.corner.any()
        assert len(frame.planes) == 0
        assert len(frame.let_go) == 0
        # Along its line a free end is known to seven pixels, some three millimetres.
        direction = np.diff(frame.lines_mm, axis=1)[:, 0]
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        along = np.einsum("ei,eij,ej->e", direction, frame.covariance_mm2[:, :3, :3], direction)
        assert (np.sqrt(along) > 1.0).all()


def test_of_nothing_the_frame_is_empty(rig) -> None:
    one = tracks_of(rig, CUBE.edges_mm[:1])
    nothing = dataclasses.replace(
        one,
        **{
            name: getattr(one, name)[:0]
            for name in (
                *("index", "fragments_px", "fragments_covariance_px2", "lines_mm"),
                *("covariance_mm2", "stage", "posterior", "rival_posterior"),
            )
        },
    )
    frame = wireframe(nothing, rig)
    assert (len(frame), len(frame.vertices_mm), len(frame.planes)) == (0, 0, 0)
    assert frame.lines_mm.shape == (0, 2, 3)
    assert frame.covariance_mm2.shape == (0, 6, 6)
    with pytest.raises(InputError, match="match the segments again"):
        wireframe(dataclasses.replace(nothing, fragments_covariance_px2=None), rig)
