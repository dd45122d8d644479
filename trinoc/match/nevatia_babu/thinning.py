"""Thinning: pixels whose gradient is largest across the edge.

Nevatia and Babu keep a pixel when its magnitude exceeds the magnitudes of its two neighbours
across the edge, and those neighbours point about the same way. Both conditions are one here:
the neighbours' gradients are projected on the pixel's own direction before comparison.
"""

import numpy as np
from jaxtyping import Bool

from trinoc.match.nevatia_babu.edge_points import EdgePoints
from trinoc.match.nevatia_babu.gradient import Gradient
from trinoc.match.nevatia_babu.levels import Level

# Linking looks two pixels to each side.
BORDER_PX = 2


def edge_points(
    gradient: Gradient,
    level: Level,
    threshold: float,
    excluded: Bool[np.ndarray, "h w"] | None = None,
) -> EdgePoints:
    """Thin the gradient to edge points stronger than `threshold` standard deviations of noise.

    The neighbours are taken along the axis of the picture that is nearer to the gradient,
    where samples need no interpolation. Pixels that are `excluded` give no points.
    """
    width = gradient.u.shape[1]
    strong = gradient.squared > np.float32(
        (threshold * level.sigma_strength * level.spacing_px) ** 2
    )
    if excluded is not None:
        strong &= ~excluded
    strong[:BORDER_PX] = strong[-BORDER_PX:] = False
    strong[:, :BORDER_PX] = strong[:, -BORDER_PX:] = False
    pixel = np.flatnonzero(strong)
    u, v = gradient.u.ravel(), gradient.v.ravel()
    gu, gv = u[pixel], v[pixel]
    along_u = np.abs(gu) >= np.abs(gv)
    step = np.where(along_u, 1, width)
    centre = gu * gu + gv * gv
    before = gu * u[pixel - step] + gv * v[pixel - step]
    after = gu * u[pixel + step] + gv * v[pixel + step]
    # One of the two comparisons admits equality, or a plateau of two would lose both.
    peak = np.flatnonzero((centre > before) & (centre >= after))

    centre = np.sqrt(centre[peak])
    profile = np.stack([before[peak] / centre, centre, after[peak] / centre], axis=-1)
    return EdgePoints.at_pixels(
        pixel[peak], np.stack([gu[peak], gv[peak]], axis=-1), along_u[peak], profile, level
    )
