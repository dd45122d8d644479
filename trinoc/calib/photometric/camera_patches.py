"""The pixels of an extended fit as rows from which the sheet's patches are read."""

import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib.photometric.camera_covariance import CameraFit
from trinoc.calib.photometric.camera_scene import CameraScene
from trinoc.calib.photometric.patches import LocalLight, PixelRows, homography_of_pose
from trinoc.calib.photometric.pixel_selection import SelectedPixels


def camera_rows(
    scene: CameraScene, chosen: SelectedPixels, fit: CameraFit
) -> tuple[Float[np.ndarray, "3 3"], PixelRows]:
    """The pixels that stayed, at the end of the extended fit, and the homography there.

    chosen : all pixels, in the scene's order.
    """
    kept = np.flatnonzero(fit.sums.weight)
    size = scene.model.size
    free = [k for k in fit.active if k >= size]
    middle, prior = scene.prior
    pull = prior[free] * (fit.state.flat[np.array(free) - size] - middle[free])
    near_lines = np.arange(len(scene.grey)) >= scene.counts[0]
    rays = [
        jax.tree.map(lambda leaf, count=count: np.asarray(leaf)[:count], group.pixels.ray)
        for group, count in zip(scene.groups, scene.counts, strict=True)
    ]
    ray = jax.tree.map(lambda *leaves: np.concatenate(leaves)[kept], *rays)
    local = None
    if fit.sums.local is not None and scene.blocks is not None:
        local = LocalLight(scene.blocks.part(kept), fit.sums.local[0][:, kept], fit.state.levels)
    # Neighbours share noise, and it is not all that the levels say: as the pose knows of it.
    weight = fit.sums.weight[kept] / fit.inflation
    rows = PixelRows(
        np.where(near_lines, -1, chosen.circle)[kept],
        ray,
        fit.by_shift[:, kept],
        fit.sums.rows[free][:, kept],
        fit.sums.residual[kept],
        weight,
        prior[free] / fit.inflation,
        pull / fit.inflation,
        local,
    )
    return np.asarray(homography_of_pose(fit.state.pose)), rows
