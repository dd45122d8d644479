"""Residuals of one line in one image, and the prior of the cameras from the calibration.

A line is represented by two anchor points X1, X2 on it. A neighbouring line intersects each of the
two planes through the anchors, normal to the line, in one point. The two offsets in each plane are
local coordinates, a minimal parametrization of a line (compare Bartoli and Sturm 2005,
doi:10.1016/j.cviu.2005.06.001). They are defined anew after each step.

Only the distances of the segment's ends perpendicular to the line are used. The position of an end
along the line depends on the detector, not on the camera.

Estimate and covariance of the calibration contain the information of its images about the cameras,
to second order, including systematic errors that the cameras have in common.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import jax.scipy.linalg
from jaxtyping import Bool, Float

from trinoc.calib.bundle.camera import CameraState
from trinoc.geometry.lines import (
    line_of_planes,
    line_through,
    plane_of_line,
    signed_distance,
)
from trinoc.geometry.projection import project_by_matrix
from trinoc.numerics.precision import ArrayLike

# numerical: number of angles in a pose.
ANGLES = 3


def complete_basis(direction: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2 3"]:
    """Two unit vectors, (2, 3), orthogonal to a direction and to each other."""
    axis = direction / jnp.sqrt(direction @ direction)
    # The coordinate axis with the largest angle to the direction cannot be parallel to it.
    across = jnp.eye(3)[jnp.argmin(jnp.abs(axis))]
    first = jnp.cross(axis, across)
    first = first / jnp.sqrt(first @ first)
    return jnp.stack([first, jnp.cross(axis, first)])


def retract_line(
    anchors_mm: Float[ArrayLike, "2 3"], offsets_mm: Float[ArrayLike, "4"]
) -> Float[ArrayLike, "2 3"]:
    """Move a line that is given by two anchor points on it. Returns the new anchors, (2, 3).

    offsets_mm : (4,) two offsets of each anchor, perpendicular to the line.
    """
    return anchors_mm + offsets_mm.reshape(2, 2) @ complete_basis(anchors_mm[1] - anchors_mm[0])


def line_residual(
    camera: CameraState,
    anchors_mm: Float[ArrayLike, "2 3"],
    fragment_px: Float[ArrayLike, "2 2"],
    covariance_px2: Float[ArrayLike, "4 4"],
) -> Float[ArrayLike, "2"]:
    """Signed distances, (2,), of a segment's two ends from the image of a line, whitened to sigmas.

    The distances are measured in undistorted pixels, where the image of the line is straight.

    Parameters
    ----------
    camera : the observing camera.
    anchors_mm : (2, 3) two points on the line.
    fragment_px : (2, 2) ends of the used part of the segment, in pixels of the original image.
    covariance_px2 : (4, 4) covariance of these ends.
    """
    image = jax.vmap(project_by_matrix, (None, 0))(camera.matrix_px, anchors_mm)
    line = line_through(image[0], image[1])
    ends = jax.vmap(camera.lens.undistort_pixel)(fragment_px)
    distances = jnp.stack([signed_distance(line, ends[0]), signed_distance(line, ends[1])])
    return whiten_across(fragment_px, covariance_px2) @ distances


def whiten_across(
    fragment_px: Float[ArrayLike, "2 2"], covariance_px2: Float[ArrayLike, "4 4"]
) -> Float[ArrayLike, "2 2"]:
    """Whitening matrix W, (2, 2), of the errors of a fragment's ends perpendicular to the fragment.

    W S W^T = I for the covariance S of these two errors.
    """
    direction = fragment_px[1] - fragment_px[0]
    direction = direction / jnp.sqrt(direction @ direction)
    normal = jnp.stack([-direction[1], direction[0]])
    blocks = covariance_px2.reshape(2, 2, 2, 2)
    variance = jnp.einsum("i,aibj,j->ab", normal, blocks, normal)
    first = jnp.sqrt(variance[0, 0])
    slope = variance[0, 1] / first
    second = jnp.sqrt(variance[1, 1] - slope**2)
    zero = jnp.zeros_like(first)
    return jnp.stack(
        [jnp.stack([1 / first, zero]), jnp.stack([-slope / (first * second), 1 / second])]
    )


def line_from_two_views(
    cameras: CameraState,
    anchors_mm: Float[ArrayLike, "2 3"],
    fragments_px: Float[ArrayLike, "v 2 2"],
    is_observed: Bool[ArrayLike, "v"],
) -> Float[ArrayLike, "2 3"]:
    """Line through the two interpretation planes of a track with two views, as two points, (2, 3).

    The interpretation plane of a fragment contains the camera's centre and the fragment. The
    returned points are those of the line nearest to `anchors_mm`. A line with more views, or with
    coincident planes, is returned unchanged.
    """

    def plane(camera: CameraState, fragment_px: ArrayLike) -> ArrayLike:
        ends = jax.vmap(camera.lens.undistort_pixel)(fragment_px)
        plane = plane_of_line(camera.matrix_px, line_through(ends[0], ends[1]))
        return plane / jnp.sqrt(plane[:3] @ plane[:3])

    planes = jax.vmap(plane)(cameras, fragments_px)
    last = is_observed.shape[0] - 1 - jnp.argmax(is_observed[::-1])
    point, direction = line_of_planes(planes[jnp.argmax(is_observed)], planes[last])
    along = (anchors_mm - point[None, :]) @ direction
    line = point[None, :] + along[:, None] * direction[None, :]
    return jnp.where((jnp.sum(is_observed) == 2) & jnp.all(jnp.isfinite(line)), line, anchors_mm)


class PriorEquations(NamedTuple):
    """Normal equations of the calibration prior, evaluated at given camera parameters.

    Attributes
    ----------
    by_step : (k, k) Jacobian of all public camera parameters with respect to their local
        coordinates.
    information, gradient : (k, k) and (k,) normal equations in local coordinates.
    """

    by_step: Float[ArrayLike, "k k"]
    information: Float[ArrayLike, "k k"]
    gradient: Float[ArrayLike, "k"]


class PosePrior(NamedTuple):
    """Gaussian prior of all refined camera parameters x, in degrees, mm and px.

    Its cost is (x - x0)^T L (x - x0).

    Attributes
    ----------
    values : (v, p) prior mean x0: the calibrated parameters.
    information : (k, k) L, the inverse of the prior covariance; 0 without a prior.
    start : calibrated cameras, relative to which rigid motions are measured.
    """

    values: Float[ArrayLike, "v p"]
    information: Float[ArrayLike, "k k"]
    start: CameraState

    def difference(self, cameras: CameraState) -> Float[ArrayLike, "k"]:
        """Parameters minus prior mean, x - x0, (k,). Differences of angles lie between -180 and 180
        degrees.
        """
        values = jax.vmap(lambda camera, start: camera.parameters(start))(cameras, self.start)
        difference = values - self.values
        turns = (difference[:, :ANGLES] + 180) % 360 - 180
        return difference.at[:, :ANGLES].set(turns).reshape(-1)

    def cost(self, cameras: CameraState) -> Float[ArrayLike, ""]:
        """Squared Mahalanobis distance between these cameras and the calibrated cameras."""
        difference = self.difference(cameras)
        return difference @ self.information @ difference

    def normal_equations(self, cameras: CameraState) -> PriorEquations:
        """Normal equations of the prior in the local coordinates of the cameras."""
        by_step = d_parameters_d_delta(cameras, self.start)
        weighted = by_step.T @ self.information
        return PriorEquations(by_step, weighted @ by_step, weighted @ self.difference(cameras))


def d_parameters_d_delta(cameras: CameraState, start: CameraState) -> Float[ArrayLike, "k k"]:
    """Block-diagonal Jacobian, (k, k), of all public camera parameters with respect to local
    coordinates.

    start : cameras relative to which rigid motions are measured.
    """
    blocks = jax.vmap(lambda camera, origin: camera.d_parameters_d_delta(origin))(cameras, start)
    return jax.scipy.linalg.block_diag(*blocks)
