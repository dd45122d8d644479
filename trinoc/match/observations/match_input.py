"""Check, undistort and sort the caller's segments and rig.

All later steps work on views sorted by content, segments sorted by position, and sorted ends of
each segment. So no result depends on the caller's order. `with_noise_scale` gives the same
segments with larger or smaller errors.
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

# numerical: two views with fewer segments may be equal by chance.
MIN_COMPARED_SEGMENTS = 3
# numerical: limits the memory. With more segments, too many likely candidates would be discarded.
MAX_SEGMENTS = 40_000
# Reason of an excluded segment: an end without a viewing ray.
BEYOND_FOLD = "beyond the fold of the lens"


class CamerasInput(NamedTuple):
    """Cameras of a frame as arrays, one row for each view.

    Attributes
    ----------
    matrix_px : (v, 3, 4)
        Projection matrices.
    centre_mm : (v, 3)
        Centres of projection, world frame.
    size_px : (v, 2)
        Width and height of the images.
    intrinsics : tuple of Intrinsics
        Lenses.
    """

    matrix_px: Float[np.ndarray, "v 3 4"]
    centre_mm: Float[np.ndarray, "v 3"]
    size_px: Float[np.ndarray, "v 2"]
    intrinsics: tuple[Intrinsics, ...]

    def take(self, views: list[int]) -> "CamerasInput":
        """Return the cameras of the views with the given indices."""
        intrinsics = tuple(self.intrinsics[view] for view in views)
        return CamerasInput(
            self.matrix_px[views], self.centre_mm[views], self.size_px[views], intrinsics
        )


class FrameInput(NamedTuple):
    """Segments and cameras of one frame, as the matcher uses them.

    Views are sorted by their segments, and segments by position. The lists have one array for each
    view.

    Attributes
    ----------
    names : tuple of str
        Names of the views.
    order : list of (n,)
        Index of each segment in the caller's input.
    ends_px : list of (n, 2, 2)
        Ends in undistorted pixels.
    covariance_px2 : list of (n, 4, 4)
        Covariance of the ends.
    polarity, sides : lists of (n,) and (n, 7)
        As in SegmentTable.
    cameras : CamerasInput
        Cameras of the views.
    exclusion_reasons : list of (k,) str
        Reason why a segment of the caller's input is excluded; "" for used segments.
    """

    names: tuple[str, ...]
    order: list[Int[np.ndarray, "_"]]
    ends_px: list[Float[np.ndarray, "_ 2 2"]]
    covariance_px2: list[Float[np.ndarray, "_ 4 4"]]
    polarity: list[Int[np.ndarray, "_"]]
    sides: list[Float[np.ndarray, "_ 7"]]
    cameras: CamerasInput
    exclusion_reasons: list[Shaped[np.ndarray, "_"]]


class MatchInput(NamedTuple):
    """Input of the matcher: one frame, or a stack of frames with the same number of views.

    The lists have one array for each view, with the segments of all frames, frame after frame.

    Attributes
    ----------
    frames : tuple of FrameInput
        The frames.
    ends_px : list of (n, 2, 2)
        Ends in undistorted pixels.
    covariance_px2 : list of (n, 4, 4)
        Covariance of the ends.
    lines : SegmentTable
        Segments of all views, padded to one length.
    """

    frames: tuple[FrameInput, ...]
    ends_px: list[Float[np.ndarray, "_ 2 2"]]
    covariance_px2: list[Float[np.ndarray, "_ 4 4"]]
    lines: SegmentTable

    @property
    def counts(self) -> list[int]:
        """Number of segments in each view, over all frames."""
        return [len(ends) for ends in self.ends_px]

    @property
    def starts(self) -> Int[np.ndarray, "_ v"]:
        """Index of the first segment of each frame, in every view, (f + 1, v).

        The last row is the number of segments in each view.
        """
        counts = np.array([[len(ends) for ends in frame.ends_px] for frame in self.frames])
        return np.concatenate([np.zeros_like(counts[:1]), np.cumsum(counts, axis=0)])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the views, for a single frame."""
        return self.frames[0].names

    @property
    def order(self) -> list[Int[np.ndarray, "_"]]:
        """Indices of the segments in the caller's input, for a single frame."""
        return self.frames[0].order


def prepare(
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    sigma_px: float | None,
    tuning: SideTuning = DEFAULT.sides,
) -> MatchInput:
    """Check the segments and cameras of one frame, and build the input of the matcher.

    Invalid input raises `MatchError` or `InputError`.
    """
    return stack_frames([prepare_frame(segments, rig, sigma_px, tuning)])


def prepare_cameras(rig: Rig, names: Iterable[str]) -> CamerasInput:
    """Check the cameras of a rig, and return their data as arrays.

    Raises
    ------
    InputError
        If a camera is mirrored.
    MatchError
        If two cameras have the same centre, or a lens can be inverted only in a small part of its
        image.
    """
    cameras = {name: rig[name] for name in names}
    check_not_mirrored(cameras)
    _check_distinct_centres(cameras, rig)
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
    """Check the segments of one frame, undistort them, and sort views, segments and ends.

    `cameras` is the result of `prepare_cameras`; if it is None, the cameras are prepared here.
    """
    _check_names(segments, rig)
    _check_counts(segments)
    cameras = prepare_cameras(rig, segments) if cameras is None else cameras
    prepared = {
        name: _prepare_view(segments[name], lens, sigma_px)
        for name, lens in zip(segments, cameras.intrinsics, strict=True)
    }
    _check_different(prepared)
    # Views with equal content are sorted by name. Only views with very few segments may be equal.
    names = tuple(sorted(prepared, key=lambda name: (_sort_key(prepared[name]), name)))
    views = [prepared[name] for name in names]
    order, ends, covariances, polarities, levels, contrasts = (
        list(column) for column in zip(*views, strict=True)
    )
    sides = side_table(levels, contrasts, [view_ends.mean(axis=1) for view_ends in ends], tuning)
    given_names = list(segments)
    ordered_cameras = cameras.take([given_names.index(name) for name in names])
    exclusion_reasons = []
    for name, used_rows in zip(names, order, strict=True):
        count = len(np.asarray(_endpoints(segments[name])))
        exclusion_reasons.append(np.full(count, BEYOND_FOLD, dtype="U40"))
        exclusion_reasons[-1][used_rows] = ""
    return FrameInput(
        names, order, ends, covariances, polarities, sides, ordered_cameras, exclusion_reasons
    )


def stack_frames(frames: Sequence[FrameInput]) -> MatchInput:
    """Join frames with the same number of views to one input of the matcher."""
    ends, covariances, polarities, sides = (
        [np.concatenate(column) for column in zip(*columns, strict=True)]
        for columns in zip(*(frame[2:6] for frame in frames), strict=True)
    )
    matrices = np.stack([frame.cameras.matrix_px for frame in frames])
    sizes = np.stack([frame.cameras.size_px for frame in frames])
    if len(frames) == 1:
        lines = segment_table(matrices[0], sizes[0], ends, covariances, polarities, sides)
    else:
        view_columns = zip(*(frame.ends_px for frame in frames), strict=True)
        frame_labels = [
            np.repeat(np.arange(len(frames)), [len(view_ends) for view_ends in column])
            for column in view_columns
        ]
        frame_capacity = bucket(len(frames))
        matrices = pad_rows(matrices, frame_capacity, matrices[0])
        sizes = pad_rows(sizes, frame_capacity, sizes[0])
        lines = segment_table(matrices, sizes, ends, covariances, polarities, sides, frame_labels)
    return MatchInput(tuple(frames), ends, covariances, lines)


class _PreparedView(NamedTuple):
    order: Int[np.ndarray, "n"]
    ends_px: Float[np.ndarray, "n 2 2"]
    covariance_px2: Float[np.ndarray, "n 4 4"]
    polarity: Int[np.ndarray, "n"]
    levels: Float[np.ndarray, "n 2"]
    contrast: Float[np.ndarray, "n"]


def _prepare_view(
    segments: Segments | ArrayLike, lens: Intrinsics, sigma_px: float | None
) -> _PreparedView:
    """Undistort the segments of a view, sort the ends of each from left to right, and sort the
    segments.

    Segments with an end beyond the fold of the lens, where its distortion is not invertible, are
    excluded.
    """
    checked = _as_segments(segments, sigma_px)
    undistorted = undistort_pixels(lens, np.asarray(checked.endpoints_px))
    covariance = np.asarray(checked.covariance_px2, dtype=np.float64)
    undistorted, covariance, is_swapped = order_ends(undistorted, covariance)
    polarity = np.where(is_swapped, -1, 1) * np.asarray(checked.polarity)
    levels = np.full((len(undistorted), 2), np.nan)
    if checked.side_levels is not None:
        levels = np.asarray(checked.side_levels, dtype=np.float64)
        levels = np.where(is_swapped[:, None], levels[:, ::-1], levels)
        # The polarity follows from the levels, so it is not independent evidence.
        polarity = np.where(np.isfinite(levels).all(axis=1), 0, polarity)
    contrast = np.abs(np.asarray(checked.contrast, dtype=np.float64))
    rank = np.lexsort(undistorted.reshape(-1, 4).T[::-1])
    rank = rank[np.isfinite(undistorted[rank]).all(axis=(1, 2))]
    return _PreparedView(
        rank, undistorted[rank], covariance[rank], polarity[rank], levels[rank], contrast[rank]
    )


def order_ends(
    ends_px: Float[np.ndarray, "n 2 2"], covariance_px2: Float[np.ndarray, "n 4 4"]
) -> tuple[Float[np.ndarray, "n 2 2"], Float[np.ndarray, "n 4 4"], Bool[np.ndarray, "n"]]:
    """Sort the two ends of each segment from left to right, and those of vertical segments
    downward.

    Returns the ends, their covariance, and the mask of the segments whose ends were exchanged.
    """
    (u0, v0), (u1, v1) = np.moveaxis(ends_px, 0, -1)
    is_swapped = (u0 > u1) | ((u0 == u1) & (v0 > v1))
    swapped = covariance_px2.reshape(-1, 2, 2, 2, 2)[:, ::-1, :, ::-1].reshape(-1, 4, 4)
    swap_mask = is_swapped[:, None, None]
    return (
        np.where(swap_mask, ends_px[:, ::-1], ends_px),
        np.where(swap_mask, swapped, covariance_px2),
        is_swapped,
    )


def _sort_key(view: _PreparedView) -> tuple[int, list[float]]:
    return len(view.ends_px), view.ends_px.reshape(-1).tolist()


def _check_names(segments: Mapping[str, Segments | ArrayLike], rig: Rig) -> None:
    check_kind(rig, Rig, "rig", A_RIG)
    expected = (
        "a dictionary of each camera's name and segments, such as the results of find_segments"
    )
    check_kind(segments, Mapping, "set of segments", expected)
    missing = [name for name in segments if name not in rig.names]
    if missing:
        raise MatchError(
            f'Segments are given for "{missing[0]}", but the rig has only the cameras '
            f"{list_names(rig)}: name the segments after the cameras."
        )
    if len(segments) < 2:
        raise MatchError(
            f"Matching needs segments of at least two cameras, but got {len(segments)}: pass "
            f"those of {list_names(rig)}."
        )


def _check_distinct_centres(names: Iterable[str], rig: Rig) -> None:
    pair = find_equal_centres({name: rig[name] for name in names})
    if pair is not None:
        raise MatchError(
            f'The cameras "{pair[0]}" and "{pair[1]}" have the same centre, so they give no '
            "depth: leave one of them out, or calibrate them again."
        )


def _check_lenses(names: Iterable[str], rig: Rig) -> None:
    for name in names:
        fold = describe_unusable_fold(rig[name].intrinsics)
        if fold is not None:
            raise MatchError(f'The lens of the camera "{name}" {fold}: {FOLD_REMEDY}')


def _check_different(views: Mapping[str, _PreparedView]) -> None:
    """Raise `MatchError` if two views have the same segments."""
    for first, second in combinations(views, 2):
        ends = views[first].ends_px
        if len(ends) >= MIN_COMPARED_SEGMENTS and np.array_equal(ends, views[second].ends_px):
            raise MatchError(
                f'Views "{first}" and "{second}" have the same segments: pass those of the '
                "image that each camera took."
            )


def _check_counts(segments: Mapping[str, Segments | ArrayLike]) -> None:
    for name, view_segments in segments.items():
        count = len(_endpoints(view_segments))
        if count > MAX_SEGMENTS:
            raise MatchError(
                f"Matching takes at most {MAX_SEGMENTS} segments per view, but "
                f'"{name}" has {count}: exclude the shortest, or match parts of the image.'
            )


def _endpoints(segments: Segments | ArrayLike) -> Float[np.ndarray, "n 2 2"]:
    return (
        np.asarray(segments.endpoints_px)
        if isinstance(segments, Segments)
        else as_endpoints(segments)
    )


def _as_segments(segments: Segments | ArrayLike, sigma_px: float | None) -> Segments:
    if not isinstance(segments, Segments):
        sigma = DEFAULT_SIGMA_PX if sigma_px is None else sigma_px
        return Segments.from_endpoints(segments, sigma_px=sigma)
    if sigma_px is None:
        return segments
    if not real_number(sigma_px, "sigma_px") > 0:
        raise InputError(f"sigma_px is {sigma_px}, but must be positive: no end is exact.")
    ends = np.asarray(segments.endpoints_px)
    covariance = covariance_of_ends(ends, sigma_px, 4 * sigma_px)
    return eqx.tree_at(lambda s: s.covariance_px2, segments, covariance)


def with_noise_scale(inputs: MatchInput, scale: Float[np.ndarray, "f"]) -> MatchInput:
    """Return the input with the errors across the segments multiplied by the `scale` of each frame.

    The errors along a segment stay, because they depend on where the detector ends the segment, not
    on noise. A scale below 1 does not reduce the error that is common to both ends
    (`common_error_variance`), because residuals do not show that error.
    """
    if (scale == 1.0).all():
        return inputs
    counts = np.diff(inputs.starts, axis=0)
    scale_of_segment = [np.repeat(scale, counts[:, view]) for view in range(len(inputs.ends_px))]
    across = np.array(inputs.lines.across_px2)
    covariance = []
    for view, (ends, view_covariance, factor) in enumerate(
        zip(inputs.ends_px, inputs.covariance_px2, scale_of_segment, strict=True)
    ):
        common_remainder = common_error_variance(across[view, : len(factor)])
        common_remainder = common_remainder * np.maximum(1 - factor**2, 0.0)
        covariance.append(_scale_covariance_across(ends, view_covariance, factor, common_remainder))
        across[view, : len(factor)] *= factor[:, None, None] ** 2
        across[view, : len(factor)] += common_remainder[:, None, None]
    return inputs._replace(
        covariance_px2=covariance, lines=inputs.lines._replace(across_px2=across)
    )


def common_error_variance(across_px2: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n"]:
    """Variance of the error that displaces a segment as a whole in all images alike, (n,) px^2.

    `across_px2` is the covariance of the two ends across the segment. Such a displacement has
    causes in the scene, such as a neighbouring edge or saturation. All images then agree on a wrong
    position.

    Notes
    -----
    Noise of variance v gives the ends the variance 4 v and the covariance -2 v. A displacement of
    variance c changes these to 4 v + c and c - 2 v. The result c is 0 for ends with independent
    errors.
    """
    end_covariance = across_px2[:, 0, 1]
    smaller_variance = np.minimum(across_px2[:, 0, 0], across_px2[:, 1, 1])
    return np.where(end_covariance > 0, (smaller_variance + 2 * end_covariance) / 3, 0.0)


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
