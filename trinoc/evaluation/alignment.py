"""Rigid alignment of 3-D lines to known edges, if they are in different frames.

Points along the lines move toward the nearest edges, only across them (point to line), under the
Geman-McClure loss. Its scale shrinks from a share of the shape's size to the remaining errors, so
that wrong lines lose their weight. Scale is not estimated: it is part of the measured error.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from trinoc.evaluation.distances import nearest_segments, sampled_segments
from trinoc.geometry.uncertain_lines import UncertainLines
from trinoc.numerics.robust_loss import GemanMcClure
from trinoc.numerics.tails import MAD_TO_SIGMA

STEP_MM_PER_SIZE = 0.01
FIRST_SCALE_PER_SIZE, SCALE_RATIO = 0.1, 2.0
MOST_STEPS = 30
# Convergence: steps below this share of the scale.
_SMALL_STEP = 1e-3
# Final scale of the loss, in robust sigmas of the remaining distances.
_LAST_SCALE_SIGMAS = 3.0
# Directions with singular values below this share of the largest are free, for example along
# parallel edges.
_RANK_TOLERANCE = 1e-6


class RigidMotion(NamedTuple):
    """Rigid motion x -> rotation x + shift_mm of 3-D lines, estimated by `align`.

    Attributes
    ----------
    rotation : (3, 3)
        Rotation matrix.
    shift_mm : (3,)
        Translation.
    rank : int
        Number of the six motion parameters that the known edges determine.
    """

    rotation: Float[np.ndarray, "3 3"]
    shift_mm: Float[np.ndarray, "3"]
    rank: int

    @property
    def turn_deg(self) -> float:
        """Angle of the rotation, degrees, from 0 to 180."""
        turn = scipy.spatial.transform.Rotation.from_matrix(self.rotation)
        return float(np.degrees(turn.magnitude()))

    def move_points(self, points_mm: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Apply the motion to points; returns points (..., 3) in mm."""
        return points_mm @ self.rotation.T + self.shift_mm

    def move_lines(self, lines: UncertainLines) -> UncertainLines:
        """Apply the motion to lines and to their covariance. The motion is assumed exact."""
        rotation_of_ends = np.kron(np.eye(2), self.rotation)
        return UncertainLines(
            self.move_points(lines.ends_mm),
            rotation_of_ends @ lines.fragment_covariance_mm2 @ rotation_of_ends.T,
            rotation_of_ends @ lines.by_parameters,
            lines.parameter_covariance,
        )


def align(
    lines_mm: Float[np.ndarray, "t 2 3"], edges_mm: Float[np.ndarray, "m 2 3"]
) -> RigidMotion:
    """Estimate the rigid motion that moves lines onto known edges.

    Parameters
    ----------
    lines_mm : (t, 2, 3)
        Ends of the lines. The search starts without motion, so lines must be closer to their edges
        than about a tenth of the shape's size.
    edges_mm : (m, 2, 3)
        Ends of the known edges.

    Returns
    -------
    RigidMotion
        If the edges do not determine a motion, such as a shift along parallel edges, that motion is
        zero and `rank` is below 6.
    """
    size = float(np.linalg.norm(np.ptp(edges_mm.reshape(-1, 3), axis=0)))
    centre = edges_mm.mean(axis=(0, 1))
    points, weight = sampled_segments(lines_mm, STEP_MM_PER_SIZE * size)
    points = points - centre
    edges = (edges_mm - centre) / size
    points = points / size
    rotation, shift, rank = np.eye(3), np.zeros(3), 6
    scale, is_last_scale = FIRST_SCALE_PER_SIZE, False
    while True:
        for _ in range(MOST_STEPS):
            moved_points = points @ rotation.T + shift
            change, rank, sigma = _step(moved_points, weight, edges, scale)
            turn = scipy.spatial.transform.Rotation.from_rotvec(change[:3]).as_matrix()
            rotation, shift = turn @ rotation, turn @ shift + change[3:]
            if np.abs(change).max() < _SMALL_STEP * scale:
                break
        if is_last_scale:
            break
        smallest = max(_LAST_SCALE_SIGMAS * sigma, 1e-9)
        scale, is_last_scale = max(scale / SCALE_RATIO, smallest), scale / SCALE_RATIO <= smallest
    return RigidMotion(rotation, size * shift + centre - rotation @ centre, rank)


def _step(
    points: Float[np.ndarray, "n 3"],
    weight: Float[np.ndarray, "n"],
    edges: Float[np.ndarray, "m 2 3"],
    scale: float,
) -> tuple[Float[np.ndarray, "6"], int, float]:
    """One Gauss-Newton step of the alignment: (step, rank, robust sigma).

    Parameters
    ----------
    points : (n, 3)
        Points on the lines, in units of the shape's size.
    weight : (n,)
        Length that each point represents.
    edges : (m, 2, 3)
        Ends of the known edges.
    scale : float
        Scale of the robust loss.

    Returns
    -------
    step : (6,)
        Rotation vector, rad, then translation.
    rank : int
        Number of parameters that the edges determine.
    sigma : float
        Robust standard deviation of the points' distances before the step.
    """
    nearest = nearest_segments(points, edges)
    first, along = edges[nearest.segment, 0], edges[nearest.segment, 1] - edges[nearest.segment, 0]
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-30)
    across = np.eye(3) - along[:, :, None] * along[:, None, :]
    residual = np.einsum("nij,nj->ni", across, points - first)
    robust_weight = weight * GemanMcClure.from_scale(scale).weight(nearest.distance_mm**2)
    # A small rotation about an axis moves a point by the cross product of axis and point.
    by_turn = np.cross(np.eye(3), points[:, None]).mT
    jacobian = across @ np.concatenate([by_turn, np.broadcast_to(np.eye(3), by_turn.shape)], axis=2)
    normal = np.einsum("n,nij,nik->jk", robust_weight, jacobian, jacobian)
    gradient = np.einsum("n,nij,ni->j", robust_weight, jacobian, residual)
    change, _, rank, _ = np.linalg.lstsq(normal, -gradient, rcond=_RANK_TOLERANCE)
    return change, int(rank), MAD_TO_SIGMA * float(np.median(nearest.distance_mm))
