"""A wireframe of two faces, a free end and a dropped part, made without matching."""

import numpy as np

from trinoc.match import Wireframe
from trinoc.match.wire_frame.frame import LetGo


def made_wireframe() -> Wireframe:
    """A square, a triangle on one of its sides, and a separate edge."""
    random = np.random.default_rng(11)
    vertices = np.array(
        [
            *([0.0, 0, 0], [30, 0, 0], [30, 20, 0], [0, 20, 0], [15, 0, 25]),
            *([50, 50, 10], [70, 50, 10]),
        ]
    )
    edges = np.array([[0, 1], [1, 2], [2, 3], [0, 3], [0, 4], [1, 4], [5, 6]])
    roots = [random.normal(size=(3 * size, 3 * size)) for size in (5, 2)]
    plane_roots = random.normal(size=(2, 4, 3))
    return Wireframe(
        vertices_mm=vertices,
        corner=np.array([True] * 5 + [False] * 2),
        vertex_chi_square=np.arange(7.0),
        vertex_degrees=np.array([3, 3, 1, 1, 1, 0, 0]),
        part=np.array([0] * 5 + [1] * 2),
        joint_covariance_mm2=tuple(root @ root.T for root in roots),
        edges=edges,
        posterior=np.linspace(0.7, 1.0, 7),
        views=np.array([3, 3, 2, 3, 3, 3, 2]),
        viewpoint_dependent=np.array([False] * 6 + [True]),
        chi_square=np.arange(7.0),
        degrees=np.full(7, 2),
        edge_of_track=np.array([0, 0, 1, 2, 3, 4, 5, 6]),
        face=np.array([0, 0, 0, 0, 1, 1, 1]),
        face_vertex=np.array([0, 1, 2, 3, 0, 1, 4]),
        planes=np.array([[0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0]]),
        planes_covariance=plane_roots @ plane_roots.mT,
        face_chi_square=np.array([0.5, 0.0]),
        face_degrees=np.array([1, 0]),
        facing=np.array([True, False]),
        let_go=LetGo(
            np.array([7]), np.array([[50.0, 50.0, 10.0]]), np.array(["ends beside a corner."])
        ),
    )
