"""The caller's segments and rig, checked, undistorted and put in an order of their own.

Everything after this works on views sorted by name, segments sorted by place and ends sorted
within a segment, so that no answer depends on the order in which the caller gave any of them.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from itertools import combinations
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int

from trinoc.errors import MatchError
from trinoc.geometry import (
    DEFAULT_SIGMA_PX,
    Camera,
    Intrinsics,
    Rig,
    Segments,
    at_one_place,
    covariance_of_ends,
)
from trinoc.match.observations.common_view import check_not_mirrored
from trinoc.match.observations.side_intensity import side_table
from trinoc.match.observations.table import SegmentTable, segment_table
from trinoc.match.tuning import DEFAULT, SideTuning
from trinoc.numerics import ArrayLike, in_bucket

# Two views of a scene may have one segment at the same place by chance, but not all of so many.
FEWEST_TO_TELL = 3


class MatchInput(NamedTuple):
    """Views in an order that depends on what they show, not on what they are called.

    names : of the views. order : (n,) per view, the caller's number of each segment.
    ends_px : (n, 2, 2) per view, undistorted. covariance_px2 : (n, 4, 4) per view.
    intrinsics : per view. lines : the padded tables of all views.
    """

    names: tuple[str, ...]
    order: list[Int[np.ndarray, "_"]]
    ends_px: list[Float[np.ndarray, "_ 2 2"]]
    covariance_px2: list[Float[np.ndarray, "_ 4 4"]]
    intrinsics: list[Intrinsics]
    lines: SegmentTable

    @property
    def counts(self) -> list[int]:
        """Number of segments in each view."""
        return [len(ends) for ends in self.ends_px]


def prepare(
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    sigma_px: float | None,
    tuning: SideTuning = DEFAULT.sides,
) -> MatchInput:
    """Check and prepare; raises MatchError and InputError in one sentence."""
    _check_names(segments, rig)
    check_not_mirrored({name: rig[name] for name in segments})
    _check_apart(segments, rig)
    prepared = {name: _view(segments[name], rig[name], sigma_px) for name in segments}
    _check_different(prepared)
    # Views that show the same, which only those with hardly a segment may, are left to their names.
    names = tuple(sorted(prepared, key=lambda name: (_content(prepared[name]), name)))
    views = [prepared[name] for name in names]
    order, ends, covariances, polarities, levels = (list(c) for c in zip(*views, strict=True))
    matrices = np.stack([rig[name].matrix_px for name in names])
    sizes = np.array([rig[name].image_size_px for name in names], dtype=np.float64)
    sides = side_table(levels, [each.mean(axis=1) for each in ends], tuning)
    lines = segment_table(matrices, sizes, ends, covariances, polarities, sides)
    return MatchInput(names, order, ends, covariances, [rig[n].intrinsics for n in names], lines)


class _PreparedView(NamedTuple):
    order: Int[np.ndarray, "n"]
    ends_px: Float[np.ndarray, "n 2 2"]
    covariance_px2: Float[np.ndarray, "n 4 4"]
    polarity: Int[np.ndarray, "n"]
    levels: Float[np.ndarray, "n 2"]


def _view(given: Segments | ArrayLike, camera: Camera, sigma_px: float | None) -> _PreparedView:
    """Segments without distortion, from left to right, in order of their coordinates."""
    segments = _as_segments(given, sigma_px)
    flat = undistorted(camera.intrinsics, np.asarray(segments.endpoints_px))
    swap = (flat[:, 0, 0] > flat[:, 1, 0]) | (
        (flat[:, 0, 0] == flat[:, 1, 0]) & (flat[:, 0, 1] > flat[:, 1, 1])
    )
    flat = np.where(swap[:, None, None], flat[:, ::-1], flat)
    covariance = np.asarray(segments.covariance_px2, dtype=np.float64)
    turned = covariance.reshape(-1, 2, 2, 2, 2)[:, ::-1, :, ::-1].reshape(-1, 4, 4)
    covariance = np.where(swap[:, None, None], turned, covariance)
    polarity = np.where(swap, -1, 1) * np.asarray(segments.polarity)
    levels = np.full((len(flat), 2), np.nan)
    if segments.side_levels is not None:
        levels = np.asarray(segments.side_levels, dtype=np.float64)
        levels = np.where(swap[:, None], levels[:, ::-1], levels)
        # Which side is darker follows from the levels: it is no evidence of its own.
        polarity = np.where(np.isfinite(levels).all(axis=1), 0, polarity)
    rank = np.lexsort(flat.reshape(-1, 4).T[::-1])
    return _PreparedView(rank, flat[rank], covariance[rank], polarity[rank], levels[rank])


def _content(view: _PreparedView) -> tuple[int, list[float]]:
    return len(view.ends_px), view.ends_px.reshape(-1).tolist()


def _check_names(segments: Mapping[str, Segments | ArrayLike], rig: Rig) -> None:
    missing = [name for name in segments if name not in rig.names]
    if missing:
        raise MatchError(
            f'Segments are given for "{missing[0]}", but the rig has only the cameras '
            f"{', '.join(rig.names)}: name the segments after the cameras."
        )
    if len(segments) < 2:
        raise MatchError(
            f"Matching needs segments of at least two cameras, but got {len(segments)}: give "
            f"those of {', '.join(rig.names)}."
        )


def _check_apart(names: Iterable[str], rig: Rig) -> None:
    pair = at_one_place({name: rig[name] for name in names})
    if pair is not None:
        raise MatchError(
            f'The cameras "{pair[0]}" and "{pair[1]}" stand at one place, which leaves depth '
            "unknown: leave one of them out, or calibrate them again."
        )


def _check_different(views: Mapping[str, _PreparedView]) -> None:
    """Raise MatchError for the segments of one picture under two names."""
    for first, second in combinations(views, 2):
        ends = views[first].ends_px
        if len(ends) >= FEWEST_TO_TELL and np.array_equal(ends, views[second].ends_px):
            raise MatchError(
                f'Views "{first}" and "{second}" have the same segments: give those of the '
                "picture that each camera took."
            )


def _as_segments(given: Segments | ArrayLike, sigma_px: float | None) -> Segments:
    if not isinstance(given, Segments):
        return Segments.from_endpoints(given, sigma_px=sigma_px or DEFAULT_SIGMA_PX)
    if sigma_px is None:
        return given
    ends = np.asarray(given.endpoints_px)
    covariance = covariance_of_ends(ends, sigma_px, 4 * sigma_px)
    return eqx.tree_at(lambda s: s.covariance_px2, given, covariance)


def undistorted(
    intrinsics: Intrinsics, points_px: Float[np.ndarray, "n 2 2"]
) -> Float[np.ndarray, "n 2 2"]:
    """Points of the picture to where a lens without distortion would show them."""
    return _mapped(intrinsics, points_px, _undistort)


def distorted(
    intrinsics: Intrinsics, points_px: Float[np.ndarray, "n 2 2"]
) -> Float[np.ndarray, "n 2 2"]:
    """Inverse of `undistorted`."""
    return _mapped(intrinsics, points_px, _distort)


def _mapped(intrinsics: Intrinsics, points_px: np.ndarray, function: Callable) -> np.ndarray:
    if not intrinsics.has_distortion or len(points_px) == 0:
        return np.asarray(points_px, dtype=np.float64)
    return in_bucket(partial(function, intrinsics), points_px)


@eqx.filter_jit
def _undistort(intrinsics: Intrinsics, points_px: ArrayLike) -> ArrayLike:
    return jax.vmap(jax.vmap(intrinsics.undistort_pixel))(points_px)


@eqx.filter_jit
def _distort(intrinsics: Intrinsics, points_px: ArrayLike) -> ArrayLike:
    return jax.vmap(jax.vmap(intrinsics.distort_pixel))(points_px)
