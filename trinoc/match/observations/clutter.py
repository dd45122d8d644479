"""The clutter model: density and length of segments that belong to no line."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from trinoc.match.observations.table import SegmentTable
from trinoc.match.tuning import DEFAULT, ClutterTuning
from trinoc.numerics import ArrayLike


class ClutterModel(NamedTuple):
    """How segments of no line are distributed.

    log_density : about each segment, log of segments per pixel of area and per radian, N / (pi A).
    typical_px : typical length; lengths are spread as t / (length + t)^2.
    """

    log_density: Float[ArrayLike, "v n"]
    typical_px: Float[ArrayLike, ""]


def fit_clutter(
    lines: SegmentTable, counts: list[int], tuning: ClutterTuning = DEFAULT.clutter
) -> ClutterModel:
    """The clutter model of all segments of the images: most of them belong to other lines."""
    density, lengths = [], []
    for view, count in enumerate(counts):
        middle = np.asarray(lines.ends_px[view])[:count].mean(axis=1)
        lengths.append(np.asarray(lines.length_px[view])[:count])
        area = float(np.prod(np.asarray(lines.size_px[view])))
        if count > 2:
            # Segments often fill only a part of the picture: that of a box with their spread.
            spread = np.sqrt(np.linalg.det(np.cov(middle.T)))
            area = min(area, max(12 * float(spread), 1e-3 * area))
        everywhere = max(count, 1) / area
        here = np.full(lines.ends_px.shape[1], everywhere)
        if count > tuning.neighbours:
            # Texture and the rims of shadows put much clutter in one place.
            distance = KDTree(middle).query(middle, tuning.neighbours + 1)[0][:, -1]
            local = tuning.neighbours / (np.pi * np.maximum(distance, 1.0) ** 2)
            here[:count] = np.maximum(everywhere, local)
        density.append(np.log(here / np.pi))
    all_lengths = np.concatenate(lengths)
    return ClutterModel(
        np.array(density), np.median(all_lengths) if len(all_lengths) else np.array(1.0)
    )
