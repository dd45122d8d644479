"""Grey levels on either side of segments, as the matcher compares them between pictures."""

from collections.abc import Callable

import equinox as eqx
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.geometry.segments import Segments
from trinoc.image.light import Light
from trinoc.image.strip import nearest_levels
from trinoc.segments.tuning import DEFAULT, SegmentEndTuning

# Not near its ends.
_ALONG = np.linspace(0.1, 0.9, 16)  # numerical: samples of a median


def with_side_levels(segments: Segments, image: Shaped[np.ndarray, "..."]) -> Segments:
    """The same segments with the grey levels beside them in the picture they were found in.

    For segments of other detectors; those of `find_segments` have them. Takes the pictures that
    `find_segments` takes, and raises InputError for others.
    """
    levels = side_levels(Light.from_picture(image).levels, np.asarray(segments.endpoints_px))
    return eqx.tree_at(lambda s: s.side_levels, segments, levels, is_leaf=lambda leaf: leaf is None)


def side_levels(
    grey: Float[np.ndarray, "h w"],
    endpoints_px: Float[np.ndarray, "n 2 2"],
    to_image: Callable[[Float[np.ndarray, "p 2"]], np.ndarray] = np.asarray,
    tuning: SegmentEndTuning = DEFAULT.junctions,
) -> Float[np.ndarray, "n 2"]:
    """(n, 2) median grey level on the right and on the left of each segment.

    Right and left are of the way from the first end to the second, as seen on the picture.
    `to_image` takes points beside segments to pixels of the picture, where a lens lies between.
    """
    step = endpoints_px[:, 1] - endpoints_px[:, 0]
    right = np.stack([-step[:, 1], step[:, 0]], axis=1) / np.linalg.norm(step, axis=1)[:, None]
    away = np.array(tuning.beside_px)
    off = np.concatenate([away, -away])[:, None]
    beside = np.empty((2, len(step), 2 * len(away), len(_ALONG)))
    for axis in (0, 1):
        on = endpoints_px[:, 0, axis, None] + step[:, axis, None] * _ALONG
        np.add(on[:, None], right[:, axis, None, None] * off, out=beside[axis])
    if to_image is not np.asarray:
        beside = to_image(beside.reshape(2, -1).T).T.reshape(beside.shape)
    levels = nearest_levels(grey, *beside).reshape(len(step), 2, len(away) * len(_ALONG))
    # The mean of the two in the middle; of so few, sorting is faster than partition.
    middle = levels.shape[2] // 2
    levels.sort(axis=2)
    return levels[:, :, middle - 1 : middle + 1].mean(axis=2).astype(np.float64)
