"""Whether edges are seen through what stands before them: how often segments cross in a picture.

What is solid hides the edges behind it: they end where they meet its outline, and hardly any two
segments cross. Of wires, or of loose segments, each is seen whole, and they cross as often as if
they lay there by chance.
"""

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.tuning import OcclusionTuning


def see_through_share(
    ends_px: Float[np.ndarray, "v n 2 2"],
    index: Int[np.ndarray, "m v"],
    posterior: Float[np.ndarray, "m"],
    tuning: OcclusionTuning,
    frame: Int[np.ndarray, "m"] | None = None,
    frames: int = 1,
) -> Float[np.ndarray, "f"]:
    """Of each frame, crossings of matched segments over those by chance: 0 solid, 1 see-through.

    Each segment counts as far as a candidate that holds it is likely, so that segments which belong
    to nothing, and cross everything, hardly count. Where few crossings are to be expected, edges
    are taken to be those of solids.
    """
    share = np.zeros(frames)
    own = np.zeros(len(index), np.int64) if frame is None else frame
    for number in range(frames):
        rows, found, usual = np.flatnonzero(own == number), 0.0, tuning.prior_observations
        for view, ends in enumerate(ends_px):
            on = rows[index[rows, view] >= 0]
            segment, place = np.unique(index[on, view], return_inverse=True)
            weight = np.zeros(len(segment))
            np.maximum.at(weight, place, posterior[on])
            count = len(segment)
            # Evenly among all: they are in order of their place.
            few = np.linspace(0, count - 1, min(count, tuning.most_crossing)).astype(np.int64)
            seen, expected = crossings(ends[segment[few]], weight[few], tuning.crossing_margin_px)
            found, usual = found + seen, usual + expected
        share[number] = min(found / usual, 1.0)
    return share


def crossings(
    ends_px: Float[np.ndarray, "n 2 2"], weight: Float[np.ndarray, "n"], margin_px: float
) -> tuple[float, float]:
    """(weighted pairs of segments that cross, how many would if they were shifted by chance).

    A segment ends `margin_px` before its ends, so that those which stop at another do not cross it.
    Chance keeps lengths and directions, and shifts segments within an area of their spread.
    """
    step = ends_px[:, 1] - ends_px[:, 0]
    length = np.hypot(*step.T)
    long = length > 2 * margin_px
    if weight[long].sum() <= 0:
        return 0.0, 0.0
    ends_px, weight, length = ends_px[long], weight[long], length[long]
    unit = step[long] / length[:, None]
    inner = ends_px + margin_px * np.stack([unit, -unit], axis=1)
    normal = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    offset = (normal * inner[:, 0]).sum(axis=1)
    beside = inner @ normal.T - offset
    apart = (beside[:, 0] < 0) != (beside[:, 1] < 0)
    both = weight[:, None] * weight
    np.fill_diagonal(both, 0.0)
    middle = ends_px.mean(axis=1)
    # Of a box, each side is sqrt(12) standard deviations.
    area = 12 * np.sqrt(max(np.linalg.det(np.cov(middle.T, aweights=weight, bias=True)), 1.0))
    inside = weight * (length - 2 * margin_px)
    swept = np.abs(unit @ normal.T) * inside[:, None] * inside
    return float((both * (apart & apart.T)).sum() / 2), float(swept.sum() / 2 / area)
