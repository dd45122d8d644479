"""Segments and junctions of one image, and fragments of several views.

These observations are the input of matching and refinement.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.errors import InputError, real_number
from trinoc.numerics.display import Displayable
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.tables import (
    COVARIANCE,
    IN_PICTURE,
    NOT_INFINITE,
    NOT_NEGATIVE,
    PICTURE_SIZE,
    Column,
    ColumnCheck,
    Table,
    check_index,
    take_rows,
)
from trinoc.numerics.values import Value

# Value of `Junctions.end` where the body of a segment, not an end, lies on the junction.
BODY = -1
DEFAULT_SIGMA_PX = 0.5
# Detectors shorten or extend segments: an end is far less certain along the segment than across.
DEFAULT_SIGMA_ALONG_PX = 2.0


class Junctions(Table):
    """Points of one image where segments meet.

    The last three fields are columns of one table with a row for each segment at each junction.

    Attributes
    ----------
    uv_px : (j, 2)
        Position of each junction: the point nearest to the lines of all its segments, weighted by
        their sigmas.
    covariance_px2 : (j, 2, 2)
        Covariance of `uv_px`.
    kind : (j,)
        Type. "L": two ends. "Y": three ends. "T": an end on the body of a segment, or three ends
        of which two are collinear. "X": four ends or more.
    junction : (m,)
        Index of the junction in each row.
    segment : (m,)
        Index of the segment in each row.
    end : (m,)
        The part of the segment that lies at the junction: 0 or 1 for an end, -1 for its body.
    """

    KIND: ClassVar[str] = "junctions"
    SIDES: ClassVar[Mapping[str, str]] = {"j": "junctions", "m": "rows"}

    uv_px: Annotated[Float[ArrayLike, "j 2"], Column(IN_PICTURE, parts=("u_px", "v_px"))]
    covariance_px2: Annotated[Float[ArrayLike, "j 2 2"], Column(COVARIANCE, parts=("u_px", "v_px"))]
    kind: Annotated[
        Shaped[ArrayLike, "j"],
        Column(ColumnCheck("is no L, T, X or Y", lambda kind, _: np.isin(kind, list("LTXY")))),
    ]
    junction: Annotated[Int[ArrayLike, "m"], Column(check_index("j", "is no junction"))]
    segment: Annotated[Int[ArrayLike, "m"], Column(NOT_NEGATIVE)]
    end: Annotated[
        Int[ArrayLike, "m"],
        Column(ColumnCheck("is neither end nor body", lambda end, _: np.isin(end, (BODY, 0, 1)))),
    ]


_ENDS = ("u1_px", "v1_px", "u2_px", "v2_px")


class Segments(Displayable, Table):
    """Line segments of one image.

    Attributes
    ----------
    endpoints_px : (n, 2, 2)
        The two ends (u, v) of each segment, in pixels of the image.
    covariance_px2 : (n, 4, 4)
        Covariance of (u1, v1, u2, v2); much larger along a segment than across.
    polarity : (n,)
        Darker side of the segment, seen in the direction from the first to the second end, as
        displayed. +1: right. -1: left. 0: unknown.
    contrast : (n,)
        Difference of the grey levels on both sides; NaN if unknown.
    support : (n,)
        Number of edge points that the segment was fitted to; 0 if unknown.
    image_size_px : (width, height) or None
        Size of the image; None if unknown.
    reasons : (n,) or None
        Largest contribution to the covariance besides noise: "neighbour", "saturated", "shaded",
        "bent", or "" if there is none. None if unknown.
    chain : (n,) or None
        Id of the broken edge that the segment belongs to: collinear pieces of one edge have the
        same id. None if not computed.
    junctions : Junctions or None
        Points where the segments meet; None if not computed.
    side_levels : (n, 2) or None
        Grey level on the right and on the left of the direction from the first to the second end.
        NaN if unknown; None if not measured.
    """

    KIND: ClassVar[str] = "segments"
    IN_WORDS: ClassVar[str] = "segments"
    SIDES: ClassVar[Mapping[str, str]] = {"n": "segments"}
    DERIVED: ClassVar[Mapping[str, Sequence[str]]] = {"length_px": ()}

    endpoints_px: Annotated[
        Float[ArrayLike, "n 2 2"],
        Column(
            IN_PICTURE,
            ColumnCheck(
                "has two equal ends", lambda ends, _: (ends[:, 0] != ends[:, 1]).any(axis=1)
            ),
            parts=_ENDS,
        ),
    ]
    covariance_px2: Annotated[Float[ArrayLike, "n 4 4"], Column(COVARIANCE, parts=_ENDS)]
    polarity: Annotated[
        Int[ArrayLike, "n"],
        Column(ColumnCheck("is not -1, 0 or 1", lambda sign, _: np.isin(sign, (-1, 0, 1)))),
    ]
    contrast: Annotated[Float[ArrayLike, "n"], Column(NOT_INFINITE)]
    support: Annotated[Int[ArrayLike, "n"], Column(NOT_NEGATIVE)]
    image_size_px: Annotated[tuple[int, int] | None, Column(PICTURE_SIZE)] = eqx.field(
        static=True, default=None
    )
    reasons: Shaped[np.ndarray, "n"] | None = None
    chain: Int[ArrayLike, "n"] | None = None
    junctions: Annotated[
        Junctions | None,
        Column(
            ColumnCheck(
                "name a segment that is not there",
                lambda junctions, table: (junctions.segment < table.sides["n"]).all(),
            )
        ),
    ] = None
    side_levels: Annotated[
        Float[ArrayLike, "n 2"] | None, Column(NOT_INFINITE, parts=("level_right", "level_left"))
    ] = None

    @classmethod
    def from_endpoints(
        cls,
        endpoints_px: ArrayLike,
        *,
        sigma_px: float = DEFAULT_SIGMA_PX,
        sigma_along_px: float = DEFAULT_SIGMA_ALONG_PX,
        image_size_px: tuple[int, int] | None = None,
    ) -> "Segments":
        """Create segments from the end points that any detector returns.

        Parameters
        ----------
        endpoints_px : (n, 4), (n, 1, 4) or (n, 2, 2)
            Rows x1 y1 x2 y2, as OpenCV returns them, or pairs of ends; pixels.
        sigma_px : float
            Standard deviation of each end across the segment.
        sigma_along_px : float
            Standard deviation of each end along the segment.
        image_size_px : (width, height), optional
            Size of the image.

        Returns
        -------
        Segments
            Polarity, contrast and support are unknown.

        Raises
        ------
        InputError
            If a sigma is not positive, the shape is different, or a segment has length 0 or a
            coordinate that is not finite. The message names the first such segment.
        """
        for name, sigma in (("sigma_px", sigma_px), ("sigma_along_px", sigma_along_px)):
            if not real_number(sigma, name) > 0:
                raise InputError(f"{name} is {sigma}, but must be positive. No end is exact.")
        array = as_endpoints(endpoints_px)
        broken = np.flatnonzero(~np.isfinite(array).all(axis=(1, 2)))
        if len(broken):
            raise InputError(
                f"Segment {broken[0]} has a coordinate that is not finite ({len(broken)} such "
                "segments in all). Remove them before matching."
            )
        empty = np.flatnonzero((array[:, 0] == array[:, 1]).all(axis=1))
        if len(empty):
            raise InputError(
                f"Segment {empty[0]} has two equal ends ({len(empty)} such segments in all). "
                "Remove them before matching."
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

    def take(self, rows: np.ndarray) -> "Segments":
        """Return the segments with the indices `rows`, without junctions.

        Junctions are dropped because they contain indices of all segments.
        """
        plain = replace(self, junctions=None)
        return replace(plain, **take_rows(plain.rows(), rows))

    def append(self, more: "Segments") -> "Segments":
        """Append the segments `more`, each as the only piece of a new chain.

        `more` must have no junctions. Optional columns that this object lacks are dropped from
        `more`.
        """
        first = int(np.max(self.chain, initial=-1)) + 1 if self.chain is not None else 0
        others = more.rows() | {"chain": np.arange(first, first + len(more))}
        joined = {}
        for name, column in self.rows().items():
            unknown = "" if name == "reasons" else np.nan
            other = others.get(name, np.full((len(more), *np.shape(column)[1:]), unknown))
            joined[name] = np.concatenate([np.asarray(column), np.asarray(other)])
        return replace(self, **joined)

    @property
    def length_px(self) -> Float[ArrayLike, "n"]:
        """Length of each segment, the distance between its ends, (n,) px."""
        return np.linalg.norm(np.diff(self.endpoints_px, axis=1)[:, 0], axis=-1)


def as_endpoints(endpoints: ArrayLike) -> Float[np.ndarray, "n 2 2"]:
    """Convert (n, 4) or (n, 1, 4) rows x1 y1 x2 y2, or (n, 2, 2) pairs of ends, to (n, 2, 2).

    Raise `InputError` for other shapes.
    """
    if endpoints is None:
        raise InputError(
            "Segments are None, which OpenCV's detectors return for an image without segments. "
            "Give np.zeros((0, 4)) instead, or the result of find_segments."
        )
    try:
        array = np.asarray(endpoints, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"Segments of type {type(endpoints).__name__} contain no numbers. Give an (n, 4) array "
            "with rows x1 y1 x2 y2, or the result of load_segments."
        ) from error
    if array.size == 0:
        return array.reshape(0, 2, 2)
    if array.shape[1:] not in ((4,), (1, 4), (2, 2)):
        raise InputError(
            f"Segments have shape {array.shape}, but must be (n, 4) with rows x1 y1 x2 y2, "
            "(n, 1, 4) or (n, 2, 2). For an image, use the result of find_segments."
        )
    return array.reshape(-1, 2, 2)


def covariance_of_ends(
    endpoints_px: Float[np.ndarray, "n 2 2"],
    sigma_px: float | Float[np.ndarray, "n"],
    sigma_along_px: float | Float[np.ndarray, "n"],
) -> Float[np.ndarray, "n 4 4"]:
    """Covariance (n, 4, 4) of (u1, v1, u2, v2) of segments, px^2.

    The errors of the two ends are independent. `sigma_px` and `sigma_along_px` are the standard
    deviations of each end across and along its segment.
    """
    direction = np.diff(endpoints_px, axis=1)[:, 0]
    direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    along = direction[:, :, None] * direction[:, None, :]
    variance_across = np.broadcast_to(np.square(sigma_px), len(direction))[:, None, None]
    variance_along = np.broadcast_to(np.square(sigma_along_px), len(direction))[:, None, None]
    block = variance_along * along + variance_across * (np.eye(2) - along)
    covariance = np.zeros((len(direction), 4, 4))
    covariance[:, :2, :2] = covariance[:, 2:, 2:] = block
    return covariance


class LineObservations(Value):
    """Tracks of corresponding fragments, with an initial 3-D line of each track.

    A track has one fragment, a part of a segment, in each view that shows the line. The fragments
    of a track correspond end to end.

    Attributes
    ----------
    views : tuple of str
        Names of the views, the order of axis v.
    fragments_px : (t, v, 2, 2)
        Ends of the fragments, in pixels of the image; any value where a view does not show the
        line.
    covariance_px2 : (t, v, 4, 4)
        Covariance of the ends of each fragment.
    seen : (t, v)
        True where a view shows the line.
    lines_mm : (t, 2, 3)
        Two points of each line in the world frame. A refinement starts at this line and reports its
        result as a 3-D segment between these points.
    """

    views: tuple[str, ...] = eqx.field(static=True)
    fragments_px: Float[np.ndarray, "t v 2 2"]
    covariance_px2: Float[np.ndarray, "t v 4 4"]
    seen: Bool[np.ndarray, "t v"]
    lines_mm: Float[np.ndarray, "t 2 3"]

    def __check_init__(self) -> None:
        fewest = self.seen.sum(axis=1).min(initial=2)
        if fewest < 2:
            raise InputError(
                f"Track {int(np.argmin(self.seen.sum(axis=1)))} is visible in {fewest} view(s), "
                "but a line in space needs at least two. Remove such tracks."
            )

    def __len__(self) -> int:
        return len(self.lines_mm)
