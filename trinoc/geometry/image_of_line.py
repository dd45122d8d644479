"""The image of a line in space: how far points of a picture lie beside it."""

from typing import NamedTuple

from jaxtyping import Float

from trinoc.geometry.projection import project_with_jacobian
from trinoc.numerics import ArrayLike, NumpyOrTraced, namespace_of


class LineDistances(NamedTuple):
    """distance_px : signed, to the right of the direction from the first to the second end as seen
    on the picture (v down). by_ends : (px/mm) derivative by the ends of the line.
    """

    distance_px: Float[NumpyOrTraced, "*m e"]
    by_ends: Float[NumpyOrTraced, "*m e 2 3"]


def distances_from_line(
    matrix_px: Float[ArrayLike, "*m 3 4"],
    ends_mm: Float[ArrayLike, "*n 2 3"],
    points_px: Float[ArrayLike, "*m e 2"],
) -> LineDistances:
    """Distances of undistorted pixels from the image of the line through two points in space.

    Of several matrices each has its own points; leading axes of the ends are broadcast. Where the
    ends lie along the line does not matter, but that their images differ.
    """
    image = project_with_jacobian(matrix_px, ends_mm)
    uv, xp = image.uv_px, namespace_of(matrix_px, ends_mm, points_px)
    way = uv[..., 1:, :] - uv[..., :1, :]
    squared = (way**2).sum(-1)
    normal = xp.stack([-way[..., 1], way[..., 0]], axis=-1) / xp.sqrt(squared)[..., None]
    offset = points_px - uv[..., :1, :]
    # As the line turns, what it does abreast of a point is a mean of what its ends do.
    share = (offset * way).sum(-1) / squared
    across = (normal[..., None] * image.by_point).sum(-2)
    weight = xp.stack([1 - share, share], axis=-1)
    return LineDistances((offset * normal).sum(-1), -weight[..., None] * across[..., None, :, :])
