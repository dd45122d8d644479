"""Line segments of one picture, the observations that matching and refinement share."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int, Shaped

from trinoc.errors import InputError
from trinoc.geometry.junctions import Junctions
from trinoc.numerics import ArrayLike, Displayable

DEFAULT_SIGMA_PX = 0.5
# Detectors cut ends short or run past them: along the segment an end is known far less.
DEFAULT_SIGMA_ALONG_PX = 2.0


class Segments(Displayable, eqx.Module):
    """Line segments of one picture.

    Fields
    ------
    endpoints_px : (n, 2, 2) two ends (u, v) of each segment, in pixels of the picture.
    covariance_px2 : (n, 4, 4) of (u1, v1, u2, v2); much larger along a segment than across.
    polarity : (n,) +1 where the darker side lies on the right of the way from the first end
        to the second as seen on the picture, -1 where on the left, 0 where not known.
    contrast : (n,) grey levels of the step across the segment; NaN where not known.
    support : (n,) number of edge points behind each segment; 0 where not known.
    image_size_px : (width, height) of the picture, or None where not known.
    reasons : (n,) what besides noise widened the covariance most: "neighbour", "wide" (more
        blurred than usual), "saturated", "shaded", "bent", or "" for nothing; None where not known.
    chain : (n,) collinear pieces of one broken edge share a number; None where not searched.
    junctions : where the segments meet; None where not searched.
    side_levels : (n, 2) grey level beside each segment, on the right and on the left of the way
        from the first end to the second, NaN where not known; None where not measured.
    """

    endpoints_px: Float[ArrayLike, "n 2 2"]
    covariance_px2: Float[ArrayLike, "n 4 4"]
    polarity: Int[ArrayLike, "n"]
    contrast: Float[ArrayLike, "n"]
    support: Int[ArrayLike, "n"]
    image_size_px: tuple[int, int] | None = eqx.field(static=True)
    reasons: Shaped[np.ndarray, "n"] | None = None
    chain: Int[ArrayLike, "n"] | None = None
    junctions: Junctions | None = None
    side_levels: Float[ArrayLike, "n 2"] | None = None

    @classmethod
    def from_endpoints(
        cls,
        endpoints_px: ArrayLike,
        *,
        sigma_px: float = DEFAULT_SIGMA_PX,
        sigma_along_px: float = DEFAULT_SIGMA_ALONG_PX,
        image_size_px: tuple[int, int] | None = None,
    ) -> "Segments":
        """Segments of any detector: (n, 4) rows x1 y1 x2 y2, or (n, 2, 2).

        `sigma_px` is the standard deviation of each end across the segment, `sigma_along_px`
        along it. Raises InputError for other shapes, for coordinates that are not finite and
        for segments without length, and names the first of them.
        """
        array = np.asarray(endpoints_px, dtype=np.float64)
        if array.size == 0:
            array = array.reshape(0, 2, 2)
        elif array.shape[1:] not in ((4,), (2, 2)):
            raise InputError(
                f"Segments have shape {array.shape}, but must be (n, 4) with rows x1 y1 x2 y2, "
                "or (n, 2, 2)."
            )
        array = array.reshape(-1, 2, 2)
        broken = np.flatnonzero(~np.isfinite(array).all(axis=(1, 2)))
        if len(broken):
            raise InputError(
                f"Segment {broken[0]} has a coordinate that is not finite ({len(broken)} such "
                "segments in all): remove them before matching."
            )
        empty = np.flatnonzero((array[:, 0] == array[:, 1]).all(axis=1))
        if len(empty):
            raise InputError(
                f"Segment {empty[0]} has two equal ends ({len(empty)} such segments in all): "
                "remove them before matching."
            )
        count = len(array)
        return cls(
            array,
            covariance_of_ends(array, sigma_px, sigma_along_px),
            np.zeros(count, dtype=np.int64),
            np.full(count, np.nan),
            np.zeros(count, dtype=np.int64),
            image_size_px,
        )

    def __len__(self) -> int:
        return len(self.endpoints_px)

    def take(self, rows: Int[np.ndarray, "m"]) -> "Segments":
        """Some of them, without their junctions, which number all."""

        def some(column: ArrayLike | None) -> np.ndarray | None:
            return None if column is None else np.asarray(column)[rows]

        return Segments(
            np.asarray(self.endpoints_px)[rows],
            np.asarray(self.covariance_px2)[rows],
            np.asarray(self.polarity)[rows],
            np.asarray(self.contrast)[rows],
            np.asarray(self.support)[rows],
            self.image_size_px,
            some(self.reasons),
            some(self.chain),
            None,
            some(self.side_levels),
        )

    def followed_by(self, more: "Segments") -> "Segments":
        """These, and after them others, which meet none and belong to no chain of them.

        What these do not know is not known of the others either.
        """

        def joined(name: str, unknown: str | float) -> np.ndarray | None:
            own, other = getattr(self, name), getattr(more, name)
            if own is None:
                return None
            if other is None:
                other = np.full((len(more), *np.shape(own)[1:]), unknown)
            return np.concatenate([np.asarray(own), np.asarray(other)])

        chain = None
        if self.chain is not None:
            first = int(np.max(self.chain, initial=-1)) + 1
            chain = np.concatenate([self.chain, np.arange(first, first + len(more))])
        return Segments(
            np.concatenate([self.endpoints_px, more.endpoints_px]),
            np.concatenate([self.covariance_px2, more.covariance_px2]),
            np.concatenate([self.polarity, more.polarity]),
            np.concatenate([self.contrast, more.contrast]),
            np.concatenate([self.support, more.support]),
            self.image_size_px,
            joined("reasons", ""),
            chain,
            self.junctions,
            joined("side_levels", np.nan),
        )

    @property
    def length_px(self) -> Float[ArrayLike, "n"]:
        """Distance between the two ends."""
        return np.linalg.norm(np.diff(self.endpoints_px, axis=1)[:, 0], axis=-1)


def covariance_of_ends(
    endpoints_px: Float[np.ndarray, "n 2 2"],
    sigma_px: float | Float[np.ndarray, "n"],
    sigma_along_px: float | Float[np.ndarray, "n"],
) -> Float[np.ndarray, "n 4 4"]:
    """(n, 4, 4) covariance of independent ends with given sigmas across and along each segment."""
    direction = np.diff(endpoints_px, axis=1)[:, 0]
    direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    along = direction[:, :, None] * direction[:, None, :]
    variance_across = np.broadcast_to(np.square(sigma_px), len(direction))[:, None, None]
    variance_along = np.broadcast_to(np.square(sigma_along_px), len(direction))[:, None, None]
    block = variance_along * along + variance_across * (np.eye(2) - along)
    covariance = np.zeros((len(direction), 4, 4))
    covariance[:, :2, :2] = covariance[:, 2:, 2:] = block
    return covariance
