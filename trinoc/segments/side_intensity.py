"""Grey levels on either side of segments, which the matcher compares between images."""

from collections.abc import Callable

import equinox as eqx
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.geometry.segments import Segments
from trinoc.image.light import Light
from trinoc.image.strip import nearest_levels
from trinoc.segments.tuning import DEFAULT, SegmentEndTuning

# Positions along a segment, without the parts near its ends.
_ALONG = np.linspace(0.1, 0.9, 16)  # numerical: samples of a median


def with_side_levels(segments: Segments, image: Shaped[np.ndarray, "..."]) -> Segments:
    """Return the segments with the grey levels on both sides, for segments of another detector.

    Parameters
    ----------
    segments : Segments
        Segments of the image.
    image : (h, w) or (h, w, channels)
        Image in which the segments were detected, as in `find_segments`.

    Returns
    -------
    Segments
        The segments with `side_levels`.

    Raises
    ------
    InputError
        If the argument is not an image.
    """
    levels = side_levels(Light.from_picture(image).levels, np.asarray(segments.endpoints_px))
    return eqx.tree_at(lambda s: s.side_levels, segments, levels, is_leaf=lambda leaf: leaf is None)


def side_levels(
    grey: Float[np.ndarray, "h w"],
    endpoints_px: Float[np.ndarray, "n 2 2"],
    to_image: Callable[[Float[np.ndarray, "p 2"]], np.ndarray] = np.asarray,
    tuning: SegmentEndTuning = DEFAULT.junctions,
) -> Float[np.ndarray, "n 2"]:
    """Return the median grey level on the right and on the left of each segment, (n, 2).

    Right and left refer to the direction from the first to the second end, as displayed. `to_image`
    maps undistorted points to pixels of the image.
    """
    step = endpoints_px[:, 1] - endpoints_px[:, 0]
    right = np.stack([-step[:, 1], step[:, 0]], axis=1) / np.linalg.norm(step, axis=1)[:, None]
    distances = np.array(tuning.beside_px)
    offsets = np.concatenate([distances, -distances])[:, None]
    samples = np.empty((2, len(step), 2 * len(distances), len(_ALONG)))
    for axis in (0, 1):
        on = endpoints_px[:, 0, axis, None] + step[:, axis, None] * _ALONG
        np.add(on[:, None], right[:, axis, None, None] * offsets, out=samples[axis])
    if to_image is not np.asarray:
        samples = to_image(samples.reshape(2, -1).T).T.reshape(samples.shape)
    levels = nearest_levels(grey, *samples).reshape(len(step), 2, len(distances) * len(_ALONG))
    # Median of an even number; for so few, sorting is faster than partition.
    middle = levels.shape[2] // 2
    levels.sort(axis=2)
    return levels[:, :, middle - 1 : middle + 1].mean(axis=2).astype(np.float64)
