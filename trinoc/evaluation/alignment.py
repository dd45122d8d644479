"""The rigid motion that lays lines on known edges, where the two stand in different frames.

Points along the lines are drawn to the nearest edges, across them only (point to line), under
the loss of Geman and McClure, whose scale narrows from a share of the shape's size to the errors
that are left: wrong lines lose their say. Scale is not free: it is what is measured.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from trinoc.evaluation.distances import nearest_segments, sampled_segments
from trinoc.geometry.uncertain_lines import UncertainLines
from trinoc.numerics.robust_loss import GemanMcClure
from trinoc.numerics.tails import MAD_TO_SIGMA

STEP_MM_PER_SIZE = 0.01
FIRST_SCALE_PER_SIZE, SCALE_RATIO = 0.1, 2.0
MOST_STEPS = 30
# Steps below this share of the scale change no point's nearest edge that matters.
_SMALL_STEP = 1e-3
# The loss is quadratic well within this many robust sigmas of what is left.
_LAST_SCALE_SIGMAS = 3.0
# Singular values below this share of the largest leave a motion free: edges along one direction.
_RANK_TOLERANCE = 1e-6


class RigidMotion(NamedTuple):
    """x -> rotation x + shift_mm, and how many of its six numbers the edges determined."""

    rotation: Float[np.ndarray, "3 3"]
    shift_mm: Float[np.ndarray, "3"]
    rank: int

    @property
    def turn_deg(self) -> float:
        """Angle of the rotation."""
        return float(np.degrees(Rotation.from_matrix(self.rotation).magnitude()))

    def of_points(self, points_mm: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Points after the motion."""
        return points_mm @ self.rotation.T + self.shift_mm

    def of_lines(self, lines: UncertainLines) -> UncertainLines:
        """Lines and their covariance after the motion, which itself counts as exact."""
        both = np.kron(np.eye(2), self.rotation)
        return UncertainLines(
            self.of_points(lines.ends_mm),
            both @ lines.fragment_covariance_mm2 @ both.T,
            both @ lines.by_parameters,
            lines.parameter_covariance,
        )


def align(
    lines_mm: Float[np.ndarray, "t 2 3"], edges_mm: Float[np.ndarray, "m 2 3"]
) -> RigidMotion:
    """The motion of lines that lays them on the edges, from where they stand.

    They must stand near: the search starts from the identity and reaches about a tenth of the
    shape's size. What the edges leave free (a slide along edges that are all parallel) does not
    move, and `rank` is then below 6.
    """
    size = float(np.linalg.norm(np.ptp(edges_mm.reshape(-1, 3), axis=0)))
    centre = edges_mm.mean(axis=(0, 1))
    points, weight = sampled_segments(lines_mm, STEP_MM_PER_SIZE * size)
    points = points - centre
    edges = (edges_mm - centre) / size
    points = points / size
    rotation, shift, rank = np.eye(3), np.zeros(3), 6
    scale, last = FIRST_SCALE_PER_SIZE, False
    while True:
        for _ in range(MOST_STEPS):
            moved = points @ rotation.T + shift
            change, rank, spread = _step(moved, weight, edges, scale)
            turn = Rotation.from_rotvec(change[:3]).as_matrix()
            rotation, shift = turn @ rotation, turn @ shift + change[3:]
            if np.abs(change).max() < _SMALL_STEP * scale:
                break
        if last:
            break
        smallest = max(_LAST_SCALE_SIGMAS * spread, 1e-9)
        scale, last = max(scale / SCALE_RATIO, smallest), scale / SCALE_RATIO <= smallest
    return RigidMotion(rotation, size * shift + centre - rotation @ centre, rank)


def _step(
    points: Float[np.ndarray, "n 3"],
    weight: Float[np.ndarray, "n"],
    edges: Float[np.ndarray, "m 2 3"],
    scale: float,
) -> tuple[Float[np.ndarray, "6"], int, float]:
    """One Gauss-Newton step: (turn and shift, rank), and the robust sigma of the distances that
    were left before it."""
    near = nearest_segments(points, edges)
    first, along = edges[near.segment, 0], edges[near.segment, 1] - edges[near.segment, 0]
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-30)
    across = np.eye(3) - along[:, :, None] * along[:, None, :]
    residual = np.einsum("nij,nj->ni", across, points - first)
    trust = weight * GemanMcClure.from_scale(scale).weight(near.distance_mm**2)
    # A small turn about an axis moves a point by the product of the axis and the point.
    by_turn = np.cross(np.eye(3), points[:, None]).mT
    jacobian = across @ np.concatenate([by_turn, np.broadcast_to(np.eye(3), by_turn.shape)], axis=2)
    normal = np.einsum("n,nij,nik->jk", trust, jacobian, jacobian)
    gradient = np.einsum("n,nij,ni->j", trust, jacobian, residual)
    change, _, rank, _ = np.linalg.lstsq(normal, -gradient, rcond=_RANK_TOLERANCE)
    return change, int(rank), MAD_TO_SIGMA * float(np.median(near.distance_mm))
