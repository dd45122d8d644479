"""Joint adjustment of vertices against explicit generalised least squares on a small graph."""

import numpy as np

from trinoc.match.line_map.corners import Corners
from trinoc.match.line_map.lines import JoinedLines
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.wire_frame.adjustment import (
    AdjustedGraph,
    Graph,
    adjust_vertices,
    build_graph,
    line_axes,
)
from trinoc.match.wire_frame.faces import _vertices_near_plane, fit_plane
from trinoc.numerics.tails import chi_square_limit

# A corner of three edges and one more edge that closes a triangle; one line stands alone.
VERTICES = np.array(
    [
        *([0.0, 0.0, 0.0], [40.0, 2.0, 1.0], [3.0, 35.0, -2.0], [1.0, -2.0, 50.0]),
        *([90.0, 80.0, 0.0], [120.0, 85.0, 10.0]),
    ]
)
EDGES = np.array([[0, 1], [0, 2], [3, 0], [1, 2], [4, 5]])


def graph_of_exact_lines(seed: int = 0) -> Graph:
    """Lines from vertex to vertex: the vertices are exactly their ends."""
    rng = np.random.default_rng(seed)
    root = 0.1 * rng.normal(size=(len(EDGES), 6, 6))
    along = rng.uniform(0.5, 2.0, (len(EDGES), 2))
    return Graph(VERTICES[EDGES], root @ root.mT + 0.01 * np.eye(6), along, EDGES)


def observations(graph: Graph) -> tuple[np.ndarray, np.ndarray]:
    """Design and weight of the six numbers of every line: across it at both ends, and along it."""
    design, weight = [], []
    for ends, covariance, along, vertex in zip(*graph, strict=True):
        axes = line_axes(ends[None])[0]
        rows = np.zeros((6, 3 * len(VERTICES)))
        by_end = np.zeros((6, 6))
        for end in (0, 1):
            rows[3 * end : 3 * end + 3, 3 * vertex[end] : 3 * vertex[end] + 3] = axes
            by_end[3 * end : 3 * end + 3, 3 * end : 3 * end + 3] = axes
        observation_covariance = by_end @ covariance @ by_end.T
        # What a line's covariance says along it is not used: there it stops, and that is known.
        for end in (0, 1):
            observation_covariance[3 * end + 2] = observation_covariance[:, 3 * end + 2] = 0.0
            observation_covariance[3 * end + 2, 3 * end + 2] = along[end] ** 2
        design.append(rows)
        weight.append(np.linalg.inv(observation_covariance))
    return np.array(design), np.array(weight)


def test_the_covariance_is_that_of_generalised_least_squares() -> None:
    graph = graph_of_exact_lines()
    answer = adjust_vertices(graph)
    np.testing.assert_allclose(answer.points_mm, VERTICES, atol=1e-9)
    design, weight = observations(graph)
    expected = np.linalg.inv(np.einsum("lik,lij,ljm->km", design, weight, design))
    for part in (np.arange(4), np.arange(4, 6)):
        rows = (3 * part[:, None] + np.arange(3)).ravel()
        joint_covariance = answer.joint(part).reshape(len(rows), len(rows))
        np.testing.assert_allclose(
            joint_covariance, expected[np.ix_(rows, rows)], rtol=1e-7, atol=1e-12
        )


def test_a_free_end_is_known_along_its_line_as_it_was_stated() -> None:
    graph = graph_of_exact_lines()
    answer = adjust_vertices(graph)
    direction = VERTICES[5] - VERTICES[4]
    direction = direction / np.linalg.norm(direction)
    for end, vertex in enumerate((4, 5)):
        block = answer.joint(np.array([vertex]))[0, :, 0]
        np.testing.assert_allclose(direction @ block @ direction, graph.along_mm[4, end] ** 2)


def test_vertices_scatter_as_their_covariance_says() -> None:
    graph, rng = graph_of_exact_lines(), np.random.default_rng(1)
    root = np.linalg.cholesky(graph.covariance_mm2)
    axes, squares = line_axes(graph.lines_mm), []
    for _ in range(200):
        noise = (root @ rng.normal(size=(len(EDGES), 6, 1))).reshape(-1, 2, 3)
        # Across, as stated; along, lines stop as far off as is known of them.
        noise -= (noise @ axes[:, 2, :, None]) * axes[:, None, 2]
        noise += (graph.along_mm * rng.normal(size=graph.along_mm.shape))[..., None] * axes[:, 2:]
        answer = adjust_vertices(graph._replace(lines_mm=graph.lines_mm + noise))
        error = (answer.points_mm - VERTICES)[:4].ravel()
        spread = answer.joint(np.arange(4)).reshape(12, 12)
        squares.append(error @ np.linalg.solve(spread, error))
    # A mean of 200 chi-squares of 12, within four standard deviations.
    assert abs(np.mean(squares) - 12) < 4 * np.sqrt(2 * 12 / 200)


def test_a_plane_is_that_of_generalised_least_squares() -> None:
    graph = graph_of_exact_lines()
    answer = adjust_vertices(graph)
    loop, joint = np.array([0, 1, 2, 3]), answer.joint(np.arange(4))
    rng = np.random.default_rng(2)
    # Four points nearly in a plane.
    flat = np.array([[0.0, 0.0, 0.0], [40.0, 0.0, 0.0], [40.0, 35.0, 0.0], [0.0, 35.0, 0.0]])
    points = answer.points_mm.copy()
    points[:4] = flat + 0.05 * rng.normal(size=flat.shape)
    face = fit_plane(answer._replace(points_mm=points), loop)
    # Near z = 0: z = a x + b y + c under the covariance across the plane.
    normal = face.plane[:3] * np.sign(face.plane[2])
    weight = np.linalg.inv(np.einsum("i,aibj,j->ab", normal, joint, normal))
    design = np.column_stack([points[:4, :2], np.ones(4)])
    slope = np.linalg.solve(design.T @ weight @ design, design.T @ weight @ points[:4, 2])
    np.testing.assert_allclose(-normal[:2] / normal[2], slope[:2], atol=1e-5)
    residual = points[:4, 2] - design @ slope
    np.testing.assert_allclose(face.chi_square, residual @ weight @ residual, rtol=1e-3)
    spread = np.linalg.inv(design.T @ weight @ design)
    # The normal is (-a, -b, 1) up to its length, which is 1 to second order.
    np.testing.assert_allclose(face.covariance[:2, :2], spread[:2, :2], rtol=0.01)
    np.testing.assert_allclose(face.covariance[3, 3], spread[2, 2], rtol=0.01)


def test_where_a_line_stops_is_known_by_its_own_variance_and_the_detectors() -> None:
    lines = np.array([[[0.0, 0.0, 0.0], [0.0, 20.0, 0.0]]])
    # Along the line, Y: 0.09 mm^2 and 0.25 mm^2; and 3 px at 2 px per mm.
    covariance = np.diag([7.0, 0.09, 7.0, 7.0, 0.25, 7.0])[None]
    one, none = np.ones(1), np.zeros(0, dtype=np.int64)
    joined = JoinedLines(
        lines, covariance, one, np.ones(1, int), np.zeros(1, int), np.zeros((1, 2)), 2 * one, one
    )
    corners = Corners(
        *(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0), none),
        *(none, none, none, lines, covariance),
    )
    graph = build_graph(joined, corners, 3.0)
    np.testing.assert_allclose(graph.along_mm, np.sqrt([[0.09 + 1.5**2, 0.25 + 1.5**2]]))


def test_vertices_beside_a_plane_are_in_it_as_far_as_all_four_err() -> None:
    """Three corners of a square and its middle, which is the mean of two of the corners."""
    tuning, sigma_mm = DEFAULT, 0.1
    vertices_mm = np.array([[0.0, 0, 0], [10, 0, 0], [0, 10, 0], [5, 5, 0]])
    # Of the middle less the mean of the second and the third.
    of_offset = sigma_mm * np.sqrt(1 + 0.25 + 0.25)
    limit = np.sqrt(chi_square_limit(tuning.collinear.significance, 1)) * of_offset
    for share, inside in ((0.95, True), (1.05, False)):
        points = vertices_mm.copy()
        points[3, 2] = share * limit
        answer = AdjustedGraph(
            points,
            np.zeros(4, dtype=np.int64),
            (sigma_mm**2 * np.eye(12),),
            np.zeros((0, 3, 3)),
            np.zeros((0, 2, 3)),
            np.zeros((0, 2, 3, 2, 3)),
        )
        is_in_plane = _vertices_near_plane(answer, np.arange(3), tuning)
        assert is_in_plane is not None
        assert is_in_plane.tolist() == [True, True, True, inside]


def test_an_error_common_to_all_vertices_moves_none_off_the_plane_of_others() -> None:
    """The limit is in sigmas of the distance from the plane, computed from draws."""
    rng, tuning = np.random.default_rng(3), DEFAULT
    corners = np.array([[0.0, 0, 0], [30, 0, 0], [0, 20, 0], [18, 14, 0]])
    # All vertices rise by one error of 1 mm, and each by .05 mm of its own.
    rise = np.ones((4, 4)) + 0.05**2 * np.eye(4)
    joint = np.zeros((4, 3, 4, 3))
    joint[:, 2, :, 2] = rise
    joint += 1e-6 * np.eye(12).reshape(4, 3, 4, 3)
    heights = rng.multivariate_normal(np.zeros(4), rise, 20_000)
    share = np.linalg.solve(np.append(corners[:3, :2], np.ones((3, 1)), axis=1).T, [18, 14, 1])
    sigma = np.std(heights[:, 3] - heights[:, :3] @ share)
    limit = np.sqrt(chi_square_limit(tuning.collinear.significance, 1))
    for sigmas, inside in ((0.9 * limit, True), (1.1 * limit, False)):
        points = corners.copy()
        points[3, 2] = sigmas * sigma
        answer = AdjustedGraph(
            points,
            np.zeros(4, dtype=np.int64),
            (joint.reshape(12, 12),),
            np.zeros((0, 3, 3)),
            np.zeros((0, 2, 3)),
            np.zeros((0, 2, 3, 2, 3)),
        )
        is_in_plane = _vertices_near_plane(answer, np.arange(3), tuning)
        assert is_in_plane is not None
        assert is_in_plane.tolist() == [True, True, True, inside]
