"""What was found of the sheet in one picture."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int


class Detection(eqx.Module):
    """Labelled circles and lines of the sheet in one picture, in pixels of the picture.

    Fields
    ------
    circle_index : (m,) index into the pattern of each circle found.
    centres_px : (m, 2) centre of the ellipse fitted to the circle's outer edge.
    covariance_px2 : (m, 2, 2) of the centres.
    shape_px2 : (m, 2, 2) S of the ellipse (x - c)^T S^-1 (x - c) = 1.
    lines_px : (2, 3) the images of the lines along X and along Y, unit normal; NaN where
        not seen.
    image_size_px : (width, height) of the picture.
    ambiguity : (k, m) the other labellings, in the order of `circle_index`, that the pattern's
        own symmetry leaves open (a plain grid of discs looks the same turned); None when
        `circle_index` is the only one.
    """

    circle_index: Int[np.ndarray, "m"]
    centres_px: Float[np.ndarray, "m 2"]
    covariance_px2: Float[np.ndarray, "m 2 2"]
    shape_px2: Float[np.ndarray, "m 2 2"]
    lines_px: Float[np.ndarray, "2 3"]
    image_size_px: tuple[int, int] = eqx.field(static=True)
    ambiguity: Int[np.ndarray, "k m"] | None = None

    def __len__(self) -> int:
        return len(self.circle_index)

    def with_larger_sigmas(self, factor: float) -> "Detection":
        """The same circles, their centres' standard deviations `factor` times as large."""
        covariance_px2 = factor**2 * self.covariance_px2
        return eqx.tree_at(lambda detection: detection.covariance_px2, self, covariance_px2)
