"""Predicted minus observed places of the board in one view."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from trinoc.calib.shots.state import POSE_SIZE, SHEET_SIZE, Chart, moved
from trinoc.geometry import AbstractLens
from trinoc.numerics import ArrayLike

# A circle's edge is smooth: so many points of it tell its image's centre to rounding.
_EDGE_POINTS = 16
_ANGLES_RAD = 2 * np.pi * np.arange(_EDGE_POINTS) / _EDGE_POINTS


def point_on_board(
    place_mm: Float[ArrayLike, "2"], sheet: Float[ArrayLike, "4"], half_mm: Float[ArrayLike, "2"]
) -> Float[ArrayLike, "3"]:
    """Where a place of the drawing lies on the board as it is: scaled, and risen in its middle.

    The rise is w_x (1 - x^2) + w_y (1 - y^2), where x and y are shares of half the board.
    Source: mrcal, "Board deformation" in its formulation.
    """
    share = place_mm / half_mm
    rise = sheet[2:] @ (1 - share * share)
    return jnp.append(place_mm * (1 + sheet[:2]), rise)


def view_residuals(
    lens: AbstractLens,
    cam_from_rig: Float[ArrayLike, "3 4"],
    rig_from_board: Float[ArrayLike, "3 4"],
    sheet: Float[ArrayLike, "4"],
    chart: Chart,
    shape_mm: Float[ArrayLike, "n 3"],
    place_mm: Float[ArrayLike, "n 2"],
    radius_mm: Float[ArrayLike, "n"],
    uv_px: Float[ArrayLike, "n 2"],
    step: Float[ArrayLike, "k"] | None = None,
    board: Int[ArrayLike, ""] | int = 0,
    set_from_board: Float[ArrayLike, "3 4"] | None = None,
) -> Float[ArrayLike, "n 2"]:
    """Residuals in pixels, after a step of (lens, camera, sheet, board) where one is given.

    shape_mm : by which each place lies elsewhere on the board. board : which of several, whose
    place in their set is `set_from_board`; its step then follows the camera's.

    The centre of a circle's image is not the image of its centre; by how much is taken where the
    step begins: it changes a thousand times less than the places themselves.
    """
    here = lens, cam_from_rig, rig_from_board, sheet, set_from_board
    half_mm = chart.half_mm[board]
    if step is not None:
        here = _stepped(here, chart, step)

    def project(
        place: Float[ArrayLike, "2"], aside: Float[ArrayLike, "3"], at: tuple
    ) -> Float[ArrayLike, "2"]:
        own_lens, own_pose, stands, own_sheet, in_set = at
        point = point_on_board(place, own_sheet, half_mm) + aside
        if in_set is not None:
            point = in_set[:, :3] @ point + in_set[:, 3]
        in_rig = stands[:, :3] @ point + stands[:, 3]
        return own_lens.project_ray(own_pose[:, :3] @ in_rig + own_pose[:, 3])

    predicted = jax.vmap(project, (0, 0, None))(place_mm, shape_mm, here)
    if chart.has_circles:
        still = jax.lax.stop_gradient(here)
        flat = jax.lax.stop_gradient(shape_mm)
        offset = jax.vmap(
            lambda place, aside, radius: _offset(
                lambda at: project(at, aside, still), place, radius
            )
        )
        predicted += offset(place_mm, flat, radius_mm)
    return predicted - uv_px


def _stepped(here: tuple, chart: Chart, step: Float[ArrayLike, "k"]) -> tuple:
    lens, cam_from_rig, rig_from_board, sheet, set_from_board = here
    poses = 2 if set_from_board is None else 3
    size = step.shape[0] - poses * POSE_SIZE - SHEET_SIZE
    by_pose, by_sheet = step[size : size + POSE_SIZE], step[-POSE_SIZE - SHEET_SIZE : -POSE_SIZE]
    if set_from_board is not None:
        by_board = step[size + POSE_SIZE : size + 2 * POSE_SIZE]
        set_from_board = moved(set_from_board, by_board, chart.unit_mm)
    return (
        lens.retract(step[:size]),
        moved(cam_from_rig, by_pose, chart.unit_mm),
        moved(rig_from_board, step[-POSE_SIZE:], chart.unit_mm),
        sheet + chart.sheet_scale[:SHEET_SIZE] * by_sheet,
        set_from_board,
    )


def _offset(project, place_mm: Float[ArrayLike, "2"], radius_mm: Float[ArrayLike, ""]) -> Array:
    """Centroid of the image of a circle less the image of its centre; 0 for a corner."""
    is_circle = radius_mm > 0
    around = np.stack([np.cos(_ANGLES_RAD), np.sin(_ANGLES_RAD)], axis=1)
    edge = place_mm[None] + jnp.where(is_circle, radius_mm, 1.0) * around.astype(place_mm.dtype)
    middle = project(place_mm)
    offset = jax.vmap(project)(edge) - middle[None]
    tangent = _DERIVATIVE.astype(offset.dtype) @ offset
    # Green's theorem: twice the area, and three times its first moment.
    area = offset[:, 0] * tangent[:, 1] - offset[:, 1] * tangent[:, 0]
    centroid = 2.0 / 3.0 * (area @ offset) / jnp.sum(area)
    return jnp.where(is_circle, centroid, 0.0)


def _trigonometric_derivative(count: int) -> Float[np.ndarray, "n n"]:
    """Derivative at equidistant angles of the trigonometric polynomial through values there."""
    step = np.arange(count)[:, None] - np.arange(count)[None]
    cotangent = 1.0 / np.tan(np.pi * np.where(step == 0, 0.5, step) / count)
    return np.where(step == 0, 0.0, 0.5 * (-1.0) ** step * cotangent)


_DERIVATIVE = _trigonometric_derivative(_EDGE_POINTS)
