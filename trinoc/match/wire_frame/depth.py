"""Depth map of one view, along the matched lines and on the faces of their wire frame."""

import jax
import numpy as np
from jaxtyping import Float
from skimage.draw import polygon

from trinoc.geometry.camera import Camera, project
from trinoc.geometry.rig import Rig
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.wire_frame.build import wireframe
from trinoc.numerics.precision import in_float64


@in_float64
def depth_map(
    matches: Matches,
    rig: Rig,
    view: str,
    *,
    filled: bool = False,
    tuning: MatchTuning = DEFAULT,
) -> Float[np.ndarray, "h w"]:
    """Compute the depth map of one view from the matched lines, and optionally from faces.

    Parameters
    ----------
    matches : Matches
        The tracks.
    rig : Rig
        The cameras.
    view : str
        Name of the view.
    filled : bool
        False to compute the depth only for pixels on the lines that the view shows. True to fill
        the faces of the wire frame (`wireframe`) too, each pixel with the depth of the nearest
        face.
    tuning : MatchTuning
        All tuned constants.

    Returns
    -------
    (h, w)
        Depth in front of the camera at each pixel, mm; NaN where it is unknown.

    Raises
    ------
    InputError
        If the view is unknown, or `filled` needs the covariance of the fragments and it is missing.
    """
    camera = rig[view]
    width, height = camera.image_size_px
    depth = np.full((height, width), np.inf)
    is_observed = matches.index[:, matches.views.index(view)] >= 0
    for line in matches.lines_mm[is_observed]:
        _draw_line(depth, camera, line)
    if filled:
        frame = wireframe(matches, rig, tuning=tuning)
        for loop in frame.faces:
            _draw_face(depth, camera, frame.vertices_mm[loop])
    return np.where(np.isfinite(depth), depth, np.nan)


def _depths(camera: Camera, points_mm: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    pose = np.asarray(camera.cam_from_world)
    return points_mm @ pose[2, :3] + pose[2, 3]


def _draw_line(depth: Float[np.ndarray, "h w"], camera: Camera, line: np.ndarray) -> None:
    ends = np.asarray(jax.vmap(project, in_axes=(None, 0))(camera, line))
    # A line that ends beyond the fold of the lens may cross the whole image.
    length_px = np.nan_to_num(np.linalg.norm(ends[1] - ends[0]), nan=float(sum(depth.shape)))
    samples = max(int(2 * length_px), 2)
    points = line[0] + np.linspace(0, 1, samples)[:, None] * (line[1] - line[0])
    uv = np.asarray(jax.vmap(project, in_axes=(None, 0))(camera, points))
    _draw_nearest(depth, np.rint(uv[:, 1]), np.rint(uv[:, 0]), _depths(camera, points))


def _draw_face(depth: Float[np.ndarray, "h w"], camera: Camera, face: np.ndarray) -> None:
    if (_depths(camera, face) <= 0).any():
        return
    uv = np.asarray(jax.vmap(project, in_axes=(None, 0))(camera, face))
    if not np.isfinite(uv).all():
        return
    rows, columns = polygon(uv[:, 1], uv[:, 0], depth.shape)
    normalise = jax.vmap(camera.intrinsics.normalised_from_pixel)
    normalised = np.asarray(normalise(np.stack([columns, rows], axis=1).astype(np.float64)))
    rays = np.concatenate([normalised, np.ones((len(rows), 1))], axis=1)
    pose = np.asarray(camera.cam_from_world)
    corners = face @ pose[:, :3].T + pose[:, 3]
    centre = corners.mean(axis=0)
    normal = np.linalg.svd(corners - centre)[2][2]
    with np.errstate(divide="ignore"):
        _draw_nearest(depth, rows, columns, (centre @ normal) / (rays @ normal))


def _draw_nearest(
    depth: Float[np.ndarray, "h w"], rows: np.ndarray, columns: np.ndarray, value: np.ndarray
) -> None:
    """Write depths to the given pixels of the map, except where the map has a smaller depth
    already.
    """
    height, width = depth.shape
    is_inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width) & (value > 0)
    pixels = rows[is_inside].astype(np.int64), columns[is_inside].astype(np.int64)
    np.minimum.at(depth, pixels, value[is_inside])
