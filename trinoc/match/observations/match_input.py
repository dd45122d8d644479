"""The caller's segments and rig, checked, undistorted and put in an order of their own.

Everything after this works on views sorted by name, segments sorted by place and ends sorted
within a segment, so that no answer depends on the order in which the caller gave any of them.

The same segments with errors across them that are larger or smaller than they state.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.errors import InputError, MatchError, check_kind, list_names, real_number
from trinoc.geometry.intrinsics import (
    FOLD_REMEDY,
    Intrinsics,
    describe_unusable_fold,
    undistort_pixels,
)
from trinoc.geometry.rig import A_RIG, Rig, find_equal_centres
from trinoc.geometry.segments import (
    DEFAULT_SIGMA_PX,
    Segments,
    as_endpoints,
    covariance_of_ends,
)
from trinoc.match.observations.common_view import check_not_mirrored
from trinoc.match.observations.side_intensity import side_table
from trinoc.match.observations.table import SegmentTable, segment_table
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.evidence import SideTuning
from trinoc.numerics.buckets import bucket, pad_rows
from trinoc.numerics.precision import ArrayLike

# Two views of a scene may have one segment at the same place by chance, but not all of so many.
# numerical: a count, not a threshold: below it nothing can be told.
FEWEST_TO_TELL = 3
# More candidates than memory bears are let go; of so many segments, too few would be left.
# numerical: it bounds the memory.
MOST_SEGMENTS = 40_000
# The reason of a segment that has no rays at an end.
BEYOND_FOLD = "beyond the fold of the lens"


class CamerasInput(NamedTuple):
    """Projection matrices, centres, sizes of the pictures and intrinsics, in order of the views."""

    matrix_px: Float[np.ndarray, "v 3 4"]
    centre_mm: Float[np.ndarray, "v 3"]
    size_px: Float[np.ndarray, "v 2"]
    intrinsics: tuple[Intrinsics, ...]

    def take(self, views: list[int]) -> "CamerasInput":
        """Those of some views, in that order."""
        intrinsics = tuple(self.intrinsics[view] for view in views)
        return CamerasInput(
            self.matrix_px[views], self.centre_mm[views], self.size_px[views], intrinsics
        )


class FrameInput(NamedTuple):
    """Views in an order that depends on what they show, not on what they are called.

    names : of the views. order : (n,) per view, the caller's number of each segment.
    ends_px : (n, 2, 2) per view, undistorted. covariance_px2 : (n, 4, 4) per view.
    polarity, sides : per view, as in SegmentTable. cameras : their matrices, sizes and lenses.
    left_out : per view, of each of the caller's segments, why it is in no table; "" where it is.
    """

    names: tuple[str, ...]
    order: list[Int[np.ndarray, "_"]]
    ends_px: list[Float[np.ndarray, "_ 2 2"]]
    covariance_px2: list[Float[np.ndarray, "_ 4 4"]]
    polarity: list[Int[np.ndarray, "_"]]
    sides: list[Float[np.ndarray, "_ 7"]]
    cameras: CamerasInput
    left_out: list[Shaped[np.ndarray, "_"]]


class MatchInput(NamedTuple):
    """One frame, or a stack of frames of as many views each, as one table per view.

    ends_px : (n, 2, 2) per view, undistorted, the segments of each frame after those of the one
    before. covariance_px2 : (n, 4, 4) per view. lines : the padded tables of all views.
    """

    frames: tuple[FrameInput, ...]
    ends_px: list[Float[np.ndarray, "_ 2 2"]]
    covariance_px2: list[Float[np.ndarray, "_ 4 4"]]
    lines: SegmentTable

    @property
    def counts(self) -> list[int]:
        """Number of segments in each view."""
        return [len(ends) for ends in self.ends_px]

    @property
    def starts(self) -> Int[np.ndarray, "_ v"]:
        """Where each frame's segments begin in every view, and where the last one's end."""
        counts = np.array([[len(ends) for ends in frame.ends_px] for frame in self.frames])
        return np.concatenate([np.zeros_like(counts[:1]), np.cumsum(counts, axis=0)])

    @property
    def names(self) -> tuple[str, ...]:
        """Of the views of a single frame."""
        return self.frames[0].names

    @property
    def order(self) -> list[Int[np.ndarray, "_"]]:
        """The caller's numbers of the segments of a single frame."""
        return self.frames[0].order


def prepare(
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    sigma_px: float | None,
    tuning: SideTuning = DEFAULT.sides,
) -> MatchInput:
    """Check and prepare one frame; raises MatchError and InputError in one sentence."""
    return stack_frames([prepare_frame(segments, rig, sigma_px, tuning)])


def prepare_cameras(rig: Rig, names: Iterable[str]) -> CamerasInput:
    """What is needed of a rig's cameras.

    Raises InputError where one is mirrored, MatchError where two stand at one place or the fold of
    a lens leaves too little of its picture.
    """
    cameras = {name: rig[name] for name in names}
    check_not_mirrored(cameras)
    _check_apart(cameras, rig)
    _check_lenses(cameras, rig)
    return CamerasInput(
        np.stack([camera.matrix_px for camera in cameras.values()]),
        np.stack([np.asarray(camera.centre_world_mm) for camera in cameras.values()]),
        np.array([camera.image_size_px for camera in cameras.values()], dtype=np.float64),
        tuple(camera.intrinsics for camera in cameras.values()),
    )


def prepare_frame(
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    sigma_px: float | None,
    tuning: SideTuning = DEFAULT.sides,
    cameras: CamerasInput | None = None,
) -> FrameInput:
    """The same without tables; `cameras` are those of `prepare_cameras`, if at hand."""
    _check_names(segments, rig)
    _check_counts(segments)
    cameras = prepare_cameras(rig, segments) if cameras is None else cameras
    prepared = {
        name: _view(segments[name], lens, sigma_px)
        for name, lens in zip(segments, cameras.intrinsics, strict=True)
    }
    _check_different(prepared)
    # Views that show the same, which only those with hardly a segment may, are left to their names.
    names = tuple(sorted(prepared, key=lambda name: (_content(prepared[name]), name)))
    views = [prepared[name] for name in names]
    order, ends, covariances, polarities, levels, contrasts = (
        list(column) for column in zip(*views, strict=True)
    )
    sides = side_table(levels, contrasts, [each.mean(axis=1) for each in ends], tuning)
    given = list(segments)
    own = cameras.take([given.index(name) for name in names])
    left_out = []
    for name, kept in zip(names, order, strict=True):
        given_count = len(np.asarray(_endpoints(segments[name])))
        left_out.append(np.full(given_count, BEYOND_FOLD, dtype="U40"))
        left_out[-1][kept] = ""
    return FrameInput(names, order, ends, covariances, polarities, sides, own, left_out)


def stack_frames(frames: Sequence[FrameInput]) -> MatchInput:
    """Frames of as many views each as one problem."""
    ends, covariances, polarities, sides = (
        [np.concatenate(column) for column in zip(*columns, strict=True)]
        for columns in zip(*(frame[2:6] for frame in frames), strict=True)
    )
    matrices = np.stack([frame.cameras.matrix_px for frame in frames])
    sizes = np.stack([frame.cameras.size_px for frame in frames])
    if len(frames) == 1:
        lines = segment_table(matrices[0], sizes[0], ends, covariances, polarities, sides)
    else:
        of_view = zip(*(frame.ends_px for frame in frames), strict=True)
        owners = [
            np.repeat(np.arange(len(frames)), [len(own) for own in column]) for column in of_view
        ]
        most = bucket(len(frames))
        matrices, sizes = pad_rows(matrices, most, matrices[0]), pad_rows(sizes, most, sizes[0])
        lines = segment_table(matrices, sizes, ends, covariances, polarities, sides, owners)
    return MatchInput(tuple(frames), ends, covariances, lines)


class _PreparedView(NamedTuple):
    order: Int[np.ndarray, "n"]
    ends_px: Float[np.ndarray, "n 2 2"]
    covariance_px2: Float[np.ndarray, "n 4 4"]
    polarity: Int[np.ndarray, "n"]
    levels: Float[np.ndarray, "n 2"]
    contrast: Float[np.ndarray, "n"]


def _view(given: Segments | ArrayLike, lens: Intrinsics, sigma_px: float | None) -> _PreparedView:
    """Segments without distortion, from left to right, in order of their coordinates.

    Those with an end beyond the fold of the lens are left out.
    """
    segments = _as_segments(given, sigma_px)
    flat = undistort_pixels(lens, np.asarray(segments.endpoints_px))
    covariance = np.asarray(segments.covariance_px2, dtype=np.float64)
    flat, covariance, swap = order_ends(flat, covariance)
    polarity = np.where(swap, -1, 1) * np.asarray(segments.polarity)
    levels = np.full((len(flat), 2), np.nan)
    if segments.side_levels is not None:
        levels = np.asarray(segments.side_levels, dtype=np.float64)
        levels = np.where(swap[:, None], levels[:, ::-1], levels)
        # Which side is darker follows from the levels: it is no evidence of its own.
        polarity = np.where(np.isfinite(levels).all(axis=1), 0, polarity)
    contrast = np.abs(np.asarray(segments.contrast, dtype=np.float64))
    rank = np.lexsort(flat.reshape(-1, 4).T[::-1])
    rank = rank[np.isfinite(flat[rank]).all(axis=(1, 2))]
    return _PreparedView(
        rank, flat[rank], covariance[rank], polarity[rank], levels[rank], contrast[rank]
    )


def order_ends(
    ends_px: Float[np.ndarray, "n 2 2"], covariance_px2: Float[np.ndarray, "n 4 4"]
) -> tuple[Float[np.ndarray, "n 2 2"], Float[np.ndarray, "n 4 4"], Bool[np.ndarray, "n"]]:
    """(ends from left to right, or from the top where they are one above the other; their
    covariance; which segments were the other way round)."""
    (u0, v0), (u1, v1) = np.moveaxis(ends_px, 0, -1)
    swap = (u0 > u1) | ((u0 == u1) & (v0 > v1))
    swapped = covariance_px2.reshape(-1, 2, 2, 2, 2)[:, ::-1, :, ::-1].reshape(-1, 4, 4)
    which = swap[:, None, None]
    return (
        np.where(which, ends_px[:, ::-1], ends_px),
        np.where(which, swapped, covariance_px2),
        swap,
    )


def _content(view: _PreparedView) -> tuple[int, list[float]]:
    return len(view.ends_px), view.ends_px.reshape(-1).tolist()


def _check_names(segments: Mapping[str, Segments | ArrayLike], rig: Rig) -> None:
    check_kind(rig, Rig, "rig", A_RIG)
    each = "a dictionary of each camera's name and segments, such as find_segments finds"
    check_kind(segments, Mapping, "set of segments", each)
    missing = [name for name in segments if name not in rig.names]
    if missing:
        raise MatchError(
            f'Segments are given for "{missing[0]}", but the rig has only the cameras '
            f"{list_names(rig)}: name the segments after the cameras."
        )
    if len(segments) < 2:
        raise MatchError(
            f"Matching needs segments of at least two cameras, but got {len(segments)}: give "
            f"those of {list_names(rig)}."
        )


def _check_apart(names: Iterable[str], rig: Rig) -> None:
    pair = find_equal_centres({name: rig[name] for name in names})
    if pair is not None:
        raise MatchError(
            f'The cameras "{pair[0]}" and "{pair[1]}" stand at one place, which leaves depth '
            "unknown: leave one of them out, or calibrate them again."
        )


def _check_lenses(names: Iterable[str], rig: Rig) -> None:
    for name in names:
        fold = describe_unusable_fold(rig[name].intrinsics)
        if fold is not None:
            raise MatchError(f'The lens of the camera "{name}" {fold}: {FOLD_REMEDY}')


def _check_different(views: Mapping[str, _PreparedView]) -> None:
    """Raise MatchError for the segments of one picture under two names."""
    for first, second in combinations(views, 2):
        ends = views[first].ends_px
        if len(ends) >= FEWEST_TO_TELL and np.array_equal(ends, views[second].ends_px):
            raise MatchError(
                f'Views "{first}" and "{second}" have the same segments: give those of the '
                "picture that each camera took."
            )


def _check_counts(segments: Mapping[str, Segments | ArrayLike]) -> None:
    for name, given in segments.items():
        count = len(_endpoints(given))
        if count > MOST_SEGMENTS:
            raise MatchError(
                f"Matching takes {MOST_SEGMENTS} segments of a view at most, but "
                f'"{name}" has {count}: leave out the shortest, or match parts of the picture.'
            )


def _endpoints(given: Segments | ArrayLike) -> Float[np.ndarray, "n 2 2"]:
    return np.asarray(given.endpoints_px) if isinstance(given, Segments) else as_endpoints(given)


def _as_segments(given: Segments | ArrayLike, sigma_px: float | None) -> Segments:
    if not isinstance(given, Segments):
        stated = DEFAULT_SIGMA_PX if sigma_px is None else sigma_px
        return Segments.from_endpoints(given, sigma_px=stated)
    if sigma_px is None:
        return given
    if not real_number(sigma_px, "sigma_px") > 0:
        raise InputError(f"sigma_px is {sigma_px}, but must be positive: no end is exact.")
    ends = np.asarray(given.endpoints_px)
    covariance = covariance_of_ends(ends, sigma_px, 4 * sigma_px)
    return eqx.tree_at(lambda s: s.covariance_px2, given, covariance)


def with_noise_scale(seen: MatchInput, scale: Float[np.ndarray, "f"]) -> MatchInput:
    """Covariances with standard deviations across the segments times their frame's `scale`.

    Along a segment nothing changes: where a detector stops is no matter of noise. Nor does a scale
    below 1 narrow what is common to both ends (`common_error_variance`): misfits do not show it.
    """
    if (scale == 1.0).all():
        return seen
    counts = np.diff(seen.starts, axis=0)
    each = [np.repeat(scale, counts[:, view]) for view in range(len(seen.ends_px))]
    across = np.array(seen.lines.across_px2)
    covariance = []
    for view, (ends, own, factor) in enumerate(
        zip(seen.ends_px, seen.covariance_px2, each, strict=True)
    ):
        kept = common_error_variance(across[view, : len(factor)])
        kept = kept * np.maximum(1 - factor**2, 0.0)
        covariance.append(_scale_covariance_across(ends, own, factor, kept))
        across[view, : len(factor)] *= factor[:, None, None] ** 2
        across[view, : len(factor)] += kept[:, None, None]
    return seen._replace(covariance_px2=covariance, lines=seen.lines._replace(across_px2=across))


def common_error_variance(across_px2: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n"]:
    """Variance of what moves each segment as a whole, where that is more than what noise does.

    A neighbour or saturation moves an edge toward the same side in all pictures of it: they agree
    on a place that is wrong. Noise of variance v moves the middle of a line and turns it, so that
    its ends vary by 4 v and their errors have covariance -2 v; with c from what moves it as a
    whole these are 4 v + c and c - 2 v. Ends that err independently leave none.
    """
    between = across_px2[:, 0, 1]
    least = np.minimum(across_px2[:, 0, 0], across_px2[:, 1, 1])
    return np.where(between > 0, (least + 2 * between) / 3, 0.0)


def _scale_covariance_across(
    ends_px: np.ndarray,
    covariance_px2: np.ndarray,
    scale: Float[np.ndarray, "n"],
    added_px2: Float[np.ndarray, "n"],
) -> np.ndarray:
    along = ends_px[:, 1] - ends_px[:, 0]
    along = along / np.linalg.norm(along, axis=1)[:, None]
    parallel = along[:, :, None] * along[:, None, :]
    across = np.eye(2) - parallel
    stretch = np.zeros((len(ends_px), 2, 2, 2, 2))
    for end in range(2):
        stretch[:, end, :, end] = parallel + scale[:, None, None] * across
    stretch = stretch.reshape(-1, 4, 4)
    added = np.tile(added_px2[:, None, None] * across, (1, 2, 2))
    return stretch @ covariance_px2 @ stretch.mT + added
