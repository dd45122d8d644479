"""Mapping between the pixels of a lens and the points of a sheet, which may be bent.

It is found by Newton's method at the centre of each pixel. In between it is so smooth that a
quadratic through neighbouring pixels is off by (pixels / focal length)^2 of a pixel at most.
"""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from simulation.camera_picture.paper import Paper
from trinoc.geometry.camera import (
    Camera,
    depth_mm,
    project,
    sheet_from_pixel,
    viewing_direction,
)
from trinoc.numerics.precision import ArrayLike, in_float64
from trinoc.numerics.programs import kept_jit

_CHUNK = 16384
_NEWTON_STEPS, _NEWTON_PX = 8, 1e-10


class SheetView(eqx.Module):
    """A camera over a sheet; points are in the nominal millimetres of the layout."""

    camera: Camera
    paper: Paper

    @property
    def image_size_px(self) -> tuple[int, int]:
        """(width, height) of the picture."""
        return self.camera.image_size_px

    def centres_mm(self, margin_px: int) -> Float[np.ndarray, "h w 2"]:
        """Points of the layout at the pixels' centres; NaN above the horizon."""
        uv = pixel_grid_px(self.image_size_px, margin_px)
        locate = partial(_sheet_points_seen, self.camera, _as_arrays(self.paper))
        return _in_chunks(locate, uv.reshape(-1, 2)).reshape(uv.shape)

    def cells_mm(
        self,
        centres_mm: Float[np.ndarray, "h w 2"],
        divided: Int[np.ndarray, "m 2"],
        supersampling: int,
    ) -> Float[np.ndarray, "m s s 2"]:
        """Points of the layout at the cells: a quadratic through the pixel and its neighbours."""
        height, width = centres_mm.shape[:2]
        # The outermost pixels have no neighbours: they borrow the differences of the next.
        row, column = np.clip(divided, 1, (height - 2, width - 2)).T

        def neighbour(down: int, across: int) -> Float[np.ndarray, "m 2"]:
            return centres_mm[row + down, column + across]

        middle, left, right, above, below = (
            neighbour(0, 0),
            neighbour(0, -1),
            neighbour(0, 1),
            neighbour(-1, 0),
            neighbour(1, 0),
        )
        terms = [
            centres_mm[divided[:, 0], divided[:, 1]],
            (right - left) / 2,
            (below - above) / 2,
            (right - 2 * middle + left) / 2,
            (below - 2 * middle + above) / 2,
            (neighbour(1, 1) - neighbour(1, -1) - neighbour(-1, 1) + neighbour(-1, -1)) / 4,
        ]
        s, t = np.moveaxis(cell_offsets_px(supersampling).reshape(-1, 2), -1, 0)
        powers = np.stack([np.ones_like(s), s, t, s * s, t * t, s * t])
        cells = np.stack(terms, axis=-1) @ powers
        return np.moveaxis(cells, 1, 2).reshape(-1, supersampling, supersampling, 2)

    def pixels_px(self, points_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Pixels that show points of the layout; NaN for points behind the camera."""
        return _in_chunks(
            partial(_pixels_of_sheet_points, self.camera, _as_arrays(self.paper)), points_mm
        )

    def points_world_mm(self, points_mm: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 3"]:
        """World coordinates of points of the layout."""
        flat = _in_chunks(
            partial(_world_of_sheet_points, _as_arrays(self.paper)), points_mm.reshape(-1, 2)
        )
        return flat.reshape(*points_mm.shape[:-1], 3)


def pixel_grid_px(image_size_px: tuple[int, int], margin_px: int) -> Float[np.ndarray, "h w 2"]:
    """(u, v) of every pixel of a picture and of a margin round it."""
    width, height = image_size_px
    columns = np.arange(-margin_px, width + margin_px, dtype=np.float64)
    rows = np.arange(-margin_px, height + margin_px, dtype=np.float64)
    return np.stack(np.meshgrid(columns, rows), axis=-1)


def cell_offsets_px(supersampling: int) -> Float[np.ndarray, "s s 2"]:
    """Offsets (du, dv) of the cells' centres from the pixel's."""
    offset = (np.arange(supersampling) + 0.5) / supersampling - 0.5
    return np.stack(np.meshgrid(offset, offset), axis=-1)


@kept_jit
def _sheet_points_seen(
    camera: Camera, paper: Paper, uv_px: Float[ArrayLike, "n 2"]
) -> Float[ArrayLike, "n 2"]:
    def one(uv: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        def image(sheet_point: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
            return project(camera, _world(paper, sheet_point))

        def step(state: tuple) -> tuple:
            count, sheet_point, (u, v) = state
            (a, b), (c, d) = jax.jacfwd(image)(sheet_point)
            sheet_point = sheet_point - jnp.stack([d * u - b * v, a * v - c * u]) / (a * d - b * c)
            return count + 1, sheet_point, image(sheet_point) - uv

        def is_far(state: tuple) -> ArrayLike:
            count, _, residual = state
            return (count < _NEWTON_STEPS) & (jnp.abs(residual).max() > _NEWTON_PX)

        # Where a flat sheet would be seen, which is the answer for one.
        meets = viewing_direction(camera, uv)[2] * camera.pose.centre_world_mm[2] < 0
        scale = jnp.stack([jnp.asarray(factor) for factor in paper.print_scale])
        start = jnp.where(meets, sheet_from_pixel(camera, uv) / scale, jnp.nan)
        return jax.lax.while_loop(is_far, step, (0, start, image(start) - uv))[1]

    return jax.vmap(one)(uv_px)


@kept_jit
def _pixels_of_sheet_points(
    camera: Camera, paper: Paper, sheet_points_mm: Float[ArrayLike, "n 2"]
) -> Float[ArrayLike, "n 2"]:
    def one(sheet_point: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        point = _world(paper, sheet_point)
        return jnp.where(depth_mm(camera, point) > 0, project(camera, point), jnp.nan)

    return jax.vmap(one)(sheet_points_mm)


@kept_jit
def _world_of_sheet_points(
    paper: Paper, sheet_points_mm: Float[ArrayLike, "n 2"]
) -> Float[ArrayLike, "n 3"]:
    return jax.vmap(lambda sheet_point: _world(paper, sheet_point))(sheet_points_mm)


def _world(paper: Paper, place_mm: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
    """The point of the world at a point of the layout."""
    scale = jnp.stack([jnp.asarray(factor) for factor in paper.print_scale])
    return paper.surface.point_world_mm(scale * place_mm)


def _as_arrays(paper: Paper) -> Paper:
    """The paper with arrays for numbers, so that other sheets need no new compilation."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, dtype=np.float64), paper)


@in_float64
def _in_chunks(function: Callable, *points: np.ndarray) -> np.ndarray:
    """`function` of points, (n, 2) each, in pieces of one length, which compile once."""
    pieces = []
    for start in range(0, len(points[0]), _CHUNK):
        chunk = [part[start : start + _CHUNK] for part in points]
        short = _CHUNK - len(chunk[0])
        padded = [np.concatenate([part, np.zeros((short, 2))]) for part in chunk]
        pieces.append(np.asarray(function(*padded))[: len(chunk[0])])
    return np.concatenate(pieces)
