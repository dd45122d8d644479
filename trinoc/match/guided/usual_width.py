"""How wide the ridge of an edge usually is in a picture: what its segments show of its blur.

A sliver of a face, or the shadow under an edge, that is narrower than the blur makes one ridge of
two edges, whose top lies between them. That such a ridge is wider than others is its only sign.
"""

import numpy as np
from jaxtyping import Float

from trinoc.match.guided.views import PictureInput, ask

# So many of the longest segments tell, if so many of them are found again so near, px. By hand.
_LONGEST, _FEWEST, _GATE_PX = 48, 6, 1.0


def with_usual_width(
    picture: PictureInput, segments_px: Float[np.ndarray, "n 2 2"]
) -> PictureInput:
    """The picture with the median width of the ridges on its segments (undistorted pixels)."""
    length = np.linalg.norm(segments_px[:, 1] - segments_px[:, 0], axis=1)
    longest = np.sort(np.argsort(-length, kind="stable")[:_LONGEST])
    gate = np.full(len(longest), _GATE_PX)
    answer = ask(picture, segments_px[longest], gate, gate / 2, np.full(len(longest), np.inf))
    width = answer.width_px[answer.contrast > 0].reshape(-1)
    return picture._replace(usual_px=float(np.median(width)) if len(width) >= _FEWEST else np.inf)
