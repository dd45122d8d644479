"""Two-view geometry: fundamental matrix, epipoles and epipolar lines.

Points are undistorted pixels. Source: Hartley and Zisserman, chapter 9.
"""

import jax.numpy as jnp
from jaxtyping import Float

from trinoc.geometry.rotation import skew
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.small_matrices import inverse_3x3


def centre_of_matrix(matrix_px: Float[ArrayLike, "3 4"]) -> Float[ArrayLike, "3"]:
    """Centre of projection C (3,) of a (3, 4) projection matrix P, in the world frame.

    P (C, 1) = 0 is solved by Cramer's rule.
    """
    a, b, c, d = (matrix_px[:, i] for i in range(4))
    volume = a @ jnp.cross(b, c)
    return -jnp.stack([d @ jnp.cross(b, c), a @ jnp.cross(d, c), a @ jnp.cross(b, d)]) / volume


def epipole(
    matrix_b_px: Float[ArrayLike, "3 4"], matrix_a_px: Float[ArrayLike, "3 4"]
) -> Float[ArrayLike, "3"]:
    """Epipole in view b: the homogeneous image (3,) of the centre of camera a."""
    return matrix_b_px @ jnp.append(centre_of_matrix(matrix_a_px), 1.0)


def fundamental_matrix(
    matrix_b_px: Float[ArrayLike, "3 4"], matrix_a_px: Float[ArrayLike, "3 4"]
) -> Float[ArrayLike, "3 3"]:
    """Fundamental matrix F_ba (3, 3) with x_b^T F_ba x_a = 0.

    Parameters
    ----------
    matrix_b_px, matrix_a_px : (3, 4)
        Projection matrices of the two views.

    Returns
    -------
    (3, 3)
        [e_b]x M_b M_a^-1 in undistorted pixels, of no fixed scale. e_b is the epipole in view b; M
        is the left 3x3 part of a projection matrix.
    """
    transfer = matrix_b_px[:, :3] @ inverse_3x3(matrix_a_px[:, :3])
    return skew(epipole(matrix_b_px, matrix_a_px)) @ transfer


def epipolar_line(
    fundamental_ba: Float[ArrayLike, "3 3"], uv_a_px: Float[ArrayLike, "2"]
) -> Float[ArrayLike, "3"]:
    """Return the epipolar line in view b that belongs to a point of view a.

    Parameters
    ----------
    fundamental_ba : (3, 3)
        F_ba of `fundamental_matrix`.
    uv_a_px : (2,)
        Undistorted pixel of view a.

    Returns
    -------
    (3,)
        Line (a, b, c) with a unit normal: a u + b v + c = 0, in undistorted pixels of view b.
    """
    line = fundamental_ba @ jnp.append(uv_a_px, 1.0)
    return line / jnp.hypot(line[0], line[1])


def epipolar_distance_px(
    fundamental_ba: Float[ArrayLike, "3 3"],
    uv_b_px: Float[ArrayLike, "2"],
    uv_a_px: Float[ArrayLike, "2"],
) -> Float[ArrayLike, ""]:
    """Return the signed distance of a point of view b from the epipolar line of a point of view a.

    Parameters
    ----------
    fundamental_ba : (3, 3)
        F_ba of `fundamental_matrix`.
    uv_b_px, uv_a_px : (2,)
        Undistorted pixels of the two views.

    Returns
    -------
    ()
        Distance in px of view b; 0 for a perfect correspondence.
    """
    return epipolar_line(fundamental_ba, uv_a_px) @ jnp.append(uv_b_px, 1.0)
