"""A pair of segments cut to the part that both see, and what it predicts in a third view."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from trinoc.geometry.arrays import ArrayLike
from trinoc.match.pencil import Pencil, point_on_plane
from trinoc.match.picture_lines import PictureLines

SMALLEST_OVERLAP = 0.15
# sin of the least angle between the two interpretation planes of a pair.
SMALLEST_CROSSING = 0.017


class PairFragment(NamedTuple):
    """The common part of a pair in space, and its image in a third view.

    ends_mm : ends of the common part. possible : whether the pair can be one line in space.
    crossing : sin of the angle between the planes of sight, the pair's condition.
    middle_px, angle_rad, half_length_px : place, direction mod pi and half extent of the
        image in the third view. sigma_px, sigma_rad : their standard deviations.
    """

    ends_mm: Float[ArrayLike, "2 3"]
    possible: Bool[ArrayLike, ""]
    crossing: Float[ArrayLike, ""]
    middle_px: Float[ArrayLike, "2"]
    angle_rad: Float[ArrayLike, ""]
    half_length_px: Float[ArrayLike, ""]
    sigma_px: Float[ArrayLike, ""]
    sigma_rad: Float[ArrayLike, ""]


class SightPlane(NamedTuple):
    """A segment's plane of sight, as seen from two points near it.

    normal : unit normal. offset_px : (2,) signed distance of each point's image from the line.
    px_per_mm : (2,) image displacement across the line per mm along `normal`.
    covariance_px2 : (2, 2) of the line's place at the two points' images.
    """

    normal: Float[ArrayLike, "3"]
    offset_px: Float[ArrayLike, "2"]
    px_per_mm: Float[ArrayLike, "2"]
    covariance_px2: Float[ArrayLike, "2 2"]


def project(
    matrix_px: Float[ArrayLike, "3 4"], points_mm: Float[ArrayLike, "n 3"]
) -> tuple[Float[ArrayLike, "n 2"], Float[ArrayLike, "n"]]:
    """(undistorted pixels, depths) of points, for a matrix whose third row gives the depth."""
    image = points_mm @ matrix_px[:, :3].T + matrix_px[:, 3]
    return image[:, :2] / image[:, 2:], image[:, 2]


def sight_plane(
    lines: PictureLines,
    view: Int[ArrayLike, ""],
    segment: Int[ArrayLike, ""],
    points_mm: Float[ArrayLike, "2 3"],
) -> SightPlane:
    """The plane of sight of one segment at two points in space."""
    line, ends = lines.line[view, segment], lines.ends_px[view, segment]
    matrix = lines.matrix_px[view]
    image, depth = project(matrix, points_mm)
    gradient = line @ matrix[:, :3]
    steepness = jnp.sqrt(gradient @ gradient)
    direction = (ends[1] - ends[0]) / lines.length_px[view, segment]
    position = (image - ends[0]) @ direction / lines.length_px[view, segment]
    weight = jnp.stack([1 - position, position], axis=1)
    return SightPlane(
        gradient / steepness,
        image @ line[:2] + line[2],
        steepness / depth,
        weight @ lines.across_px2[view, segment] @ weight.T,
    )


def cut_pair(
    pencil: Pencil, i: Int[ArrayLike, ""], j: Int[ArrayLike, ""]
) -> tuple[Float[ArrayLike, "2 3"], Bool[ArrayLike, ""]]:
    """(ends in mm of the part both segments see, whether there is one in front of both)."""
    angles_a, angles_b = pencil.angles_a[i], pencil.angles_b[j]
    low, high = jnp.maximum(angles_a[0], angles_b[0]), jnp.minimum(angles_a[1], angles_b[1])
    shorter = jnp.minimum(angles_a[1] - angles_a[0], angles_b[1] - angles_b[0])
    rays_a, rays_b = pencil.rays_a[i], pencil.rays_b[j]
    first, first_radius = point_on_plane(pencil, rays_a, rays_b, low)
    second, second_radius = point_on_plane(pencil, rays_a, rays_b, high)
    possible = (high - low > SMALLEST_OVERLAP * shorter) & (first_radius > 0) & (second_radius > 0)
    return jnp.stack([first, second]), possible


def predict(
    lines: PictureLines,
    views: Int[ArrayLike, "3"],
    pencil: Pencil,
    i: Int[ArrayLike, ""],
    j: Int[ArrayLike, ""],
) -> PairFragment:
    """Cut segment i of the first view and j of the second, and predict them in the third."""
    ends_mm, possible = cut_pair(pencil, i, j)
    plane_a = sight_plane(lines, views[0], i, ends_mm)
    plane_b = sight_plane(lines, views[1], j, ends_mm)
    along = ends_mm[1] - ends_mm[0]
    along = along / jnp.sqrt(along @ along)
    image, depth = project(lines.matrix_px[views[2]], ends_mm)
    step = image[1] - image[0]
    length = jnp.sqrt(step @ step)
    gradient = jnp.cross(ends_mm[0] - lines.centre_mm[views[2]], along)
    normal_c = gradient / jnp.sqrt(gradient @ gradient)

    # In the plane across the line the three normals are dependent, n_c = p n_a + q n_b.
    sine_ab = along @ jnp.cross(plane_a.normal, plane_b.normal)
    sine_cb = along @ jnp.cross(normal_c, plane_b.normal)
    sine_ac = along @ jnp.cross(plane_a.normal, normal_c)
    scale_c = _px_per_mm_across(lines.matrix_px[views[2]], normal_c, image, depth)
    share_a, share_b = sine_cb / sine_ab / plane_a.px_per_mm, sine_ac / sine_ab / plane_b.px_per_mm
    covariance = (
        jnp.outer(share_a * scale_c, share_a * scale_c) * plane_a.covariance_px2
        + jnp.outer(share_b * scale_c, share_b * scale_c) * plane_b.covariance_px2
    )
    middle = (image[0] + image[1]) / 2
    size = lines.size_px[views[2]]
    possible &= (depth > 0).all() & (length > 0) & (jnp.abs(sine_ab) > SMALLEST_CROSSING)
    possible &= ((middle > -0.1 * size) & (middle < 1.1 * size)).all()
    # Of the three orderings of a triple, the one whose pair crosses best finds it.
    best = jnp.maximum(jnp.abs(sine_cb), jnp.abs(sine_ac))
    possible &= jnp.abs(sine_ab) > 0.8 * best
    return PairFragment(
        ends_mm,
        possible,
        jnp.abs(sine_ab),
        middle,
        jnp.mod(jnp.arctan2(step[1], step[0]), jnp.pi),
        length / 2,
        jnp.sqrt((covariance.sum()) / 4),
        jnp.sqrt(covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1]) / length,
    )


def _px_per_mm_across(
    matrix_px: Float[ArrayLike, "3 4"],
    normal: Float[ArrayLike, "3"],
    image: Float[ArrayLike, "2 2"],
    depth: Float[ArrayLike, "2"],
) -> Float[ArrayLike, "2"]:
    """Image displacement per mm along the normal of a plane of sight, across its line."""
    step = image[1] - image[0]
    across = jnp.stack([-step[1], step[0]]) / jnp.sqrt(step @ step)
    gradient = across @ (matrix_px[None, :2, :3] - image[:, :, None] * matrix_px[None, 2:, :3])
    return gradient @ normal / depth
