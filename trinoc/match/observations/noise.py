"""The same segments with errors across them that are larger or smaller than they state."""

import numpy as np

from trinoc.match.observations.match_input import MatchInput


def with_noise_scale(seen: MatchInput, scale: float) -> MatchInput:
    """Covariances with standard deviations across the segments times `scale`.

    Along a segment nothing changes: where a detector stops is no matter of noise.
    """
    if scale == 1.0:
        return seen
    covariance = [
        _scaled_across(ends, own, scale)
        for ends, own in zip(seen.ends_px, seen.covariance_px2, strict=True)
    ]
    across = np.asarray(seen.lines.across_px2) * scale**2
    return seen._replace(covariance_px2=covariance, lines=seen.lines._replace(across_px2=across))


def _scaled_across(ends_px: np.ndarray, covariance_px2: np.ndarray, scale: float) -> np.ndarray:
    along = ends_px[:, 1] - ends_px[:, 0]
    along = along / np.linalg.norm(along, axis=1)[:, None]
    parallel = along[:, :, None] * along[:, None, :]
    stretch = np.einsum("ef,nij->neifj", np.eye(2), parallel + scale * (np.eye(2) - parallel))
    stretch = stretch.reshape(-1, 4, 4)
    return stretch @ covariance_px2 @ stretch.mT
