"""The same segments with errors across them that are larger or smaller than they state."""

import numpy as np
from jaxtyping import Float

from trinoc.match.observations.match_input import MatchInput


def with_noise_scale(seen: MatchInput, scale: Float[np.ndarray, "f"]) -> MatchInput:
    """Covariances with standard deviations across the segments times their frame's `scale`.

    Along a segment nothing changes: where a detector stops is no matter of noise.
    """
    if (scale == 1.0).all():
        return seen
    counts = np.diff(seen.starts, axis=0)
    each = [np.repeat(scale, counts[:, view]) for view in range(len(seen.ends_px))]
    covariance = [
        _scaled_across(ends, own, factor)
        for ends, own, factor in zip(seen.ends_px, seen.covariance_px2, each, strict=True)
    ]
    across = np.array(seen.lines.across_px2)
    for view, factor in enumerate(each):
        across[view, : len(factor)] *= factor[:, None, None] ** 2
    return seen._replace(covariance_px2=covariance, lines=seen.lines._replace(across_px2=across))


def _scaled_across(
    ends_px: np.ndarray, covariance_px2: np.ndarray, scale: Float[np.ndarray, "n"]
) -> np.ndarray:
    along = ends_px[:, 1] - ends_px[:, 0]
    along = along / np.linalg.norm(along, axis=1)[:, None]
    parallel = along[:, :, None] * along[:, None, :]
    stretch = np.zeros((len(ends_px), 2, 2, 2, 2))
    for end in range(2):
        stretch[:, end, :, end] = parallel + scale[:, None, None] * (np.eye(2) - parallel)
    stretch = stretch.reshape(-1, 4, 4)
    return stretch @ covariance_px2 @ stretch.mT
