"""Line segments of one picture, where they meet, and their fragments in several pictures: the
observations that matching and refinement share."""

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
    check_number,
    take_rows,
)
from trinoc.numerics.values import Value

# The body of a segment, not one of its ends, lies on a junction.
BODY = -1
DEFAULT_SIGMA_PX = 0.5
# Detectors cut ends short or run past them: along the segment an end is known far less.
DEFAULT_SIGMA_ALONG_PX = 2.0


class Junctions(Table):
    """Where segments of one picture meet, and which of them do.

    The last three fields are one table with a row for each segment at each junction.

    Fields
    ------
    uv_px : (j, 2) the point nearest to all lines that meet, weighted by their sigmas.
    covariance_px2 : (j, 2, 2) of that point.
    kind : (j,) "L" (two ends), "Y" (three), "T" (an end on a body, or three ends of which two
        are collinear), "X" (four ends or more).
    junction : (m,) junction of each row.
    segment : (m,) segment of each row.
    end : (m,) 0 or 1, the end of the segment that meets, or -1 for its body.
    """

    KIND: ClassVar[str] = "junctions"
    SIDES: ClassVar[Mapping[str, str]] = {"j": "junctions", "m": "rows"}

    uv_px: Annotated[Float[ArrayLike, "j 2"], Column(IN_PICTURE, parts=("u_px", "v_px"))]
    covariance_px2: Annotated[Float[ArrayLike, "j 2 2"], Column(COVARIANCE, parts=("u_px", "v_px"))]
    kind: Annotated[
        Shaped[ArrayLike, "j"],
        Column(ColumnCheck("is no L, T, X or Y", lambda kind, _: np.isin(kind, list("LTXY")))),
    ]
    junction: Annotated[Int[ArrayLike, "m"], Column(check_number("j", "is no junction"))]
    segment: Annotated[Int[ArrayLike, "m"], Column(NOT_NEGATIVE)]
    end: Annotated[
        Int[ArrayLike, "m"],
        Column(ColumnCheck("is neither end nor body", lambda end, _: np.isin(end, (BODY, 0, 1)))),
    ]


_ENDS = ("u1_px", "v1_px", "u2_px", "v2_px")


class Segments(Displayable, Table):
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
    reasons : (n,) what besides noise widened the covariance most: "neighbour",
        "saturated", "shaded", "bent", or "" for nothing; None where not known.
    chain : (n,) collinear pieces of one broken edge share a number; None where not searched.
    junctions : where the segments meet; None where not searched.
    side_levels : (n, 2) grey level beside each segment, on the right and on the left of the way
        from the first end to the second, NaN where not known; None where not measured.
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
        """Segments of any detector: (n, 4) rows x1 y1 x2 y2, (n, 1, 4) as of OpenCV, or (n, 2, 2).

        `sigma_px` is the standard deviation of each end across the segment, `sigma_along_px`
        along it. Raises InputError for sigmas that are not positive, for other shapes, for
        coordinates that are not finite and for segments without length, and names the first.
        """
        for name, sigma in (("sigma_px", sigma_px), ("sigma_along_px", sigma_along_px)):
            if not real_number(sigma, name) > 0:
                raise InputError(f"{name} is {sigma}, but must be positive: no end is exact.")
        array = as_endpoints(endpoints_px)
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

    def take(self, rows: np.ndarray) -> "Segments":
        """Some of them, without their junctions, which number all."""
        plain = replace(self, junctions=None)
        return replace(plain, **take_rows(plain.rows(), rows))

    def append(self, more: "Segments") -> "Segments":
        """These, and after them others, which meet none and belong to no chain of them.

        What these do not know is not known of the others either.
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
        """Distance between the two ends."""
        return np.linalg.norm(np.diff(self.endpoints_px, axis=1)[:, 0], axis=-1)


def as_endpoints(given: ArrayLike) -> Float[np.ndarray, "n 2 2"]:
    """Rows x1 y1 x2 y2, or pairs of ends, as pairs. Raises InputError for other shapes."""
    if given is None:
        raise InputError(
            "Segments are None, which OpenCV's detectors give where they find none: give "
            "np.zeros((0, 4)) then, or what find_segments finds."
        )
    try:
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"Segments of type {type(given).__name__} hold no numbers: give an array of (n, 4) "
            "rows x1 y1 x2 y2, or what load_segments reads from a file."
        ) from error
    if array.size == 0:
        return array.reshape(0, 2, 2)
    if array.shape[1:] not in ((4,), (1, 4), (2, 2)):
        raise InputError(
            f"Segments have shape {array.shape}, but must be (n, 4) with rows x1 y1 x2 y2, "
            "(n, 1, 4) or (n, 2, 2); those of a picture are what find_segments finds."
        )
    return array.reshape(-1, 2, 2)


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


class LineObservations(Value):
    """Tracks of fragments, and a first estimate of the line that each shows.

    Fields
    ------
    views : names of the views, the order of axis v.
    fragments_px : (t, v, 2, 2) corresponding ends, in pixels of the picture; anything where
        not seen.
    covariance_px2 : (t, v, 4, 4) of the fragments' ends.
    seen : (t, v) whether a view shows the line.
    lines_mm : (t, 2, 3) two points of each line, from where the refinement starts; the 3-D
        segment is reported between them.
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
                f"Track {int(np.argmin(self.seen.sum(axis=1)))} is seen in {fewest} view(s), but a "
                "line in space needs at least two: leave such tracks out."
            )

    def __len__(self) -> int:
        return len(self.lines_mm)
