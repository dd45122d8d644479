"""What the noise of the picture makes of a line's place, and what disturbs it beyond.

The pull of neighbouring edges, taken out of the positions of edge points.

Two edges closer than a few widths of the profile overlap in the gradient, and each shifts
the other's peak. Once all lines are known, what each neighbour adds to the three samples of
a point's profile can be computed and subtracted, and the point located again.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped

from trinoc.image.light import Light
from trinoc.image.strip import nearest_levels
from trinoc.numerics.joins import distinct, expand_ranges, point_tree
from trinoc.segments.nevatia_babu.accept import BOW_OF_MIDDLE, Shifts
from trinoc.segments.nevatia_babu.endpoints import SAMPLE_PX, line_samples
from trinoc.segments.nevatia_babu.line_fit import FittedLines
from trinoc.segments.nevatia_babu.runs import FARTHEST, LEAST_SIDE, EdgePoints, Runs
from trinoc.segments.tuning import DEFAULT, ErrorTuning

# Fourth cumulant of the kernel's profile: its tails fall faster than a Gaussian's.
_TAIL = 2.6 / 24  # numerical: a property of the masks
_ERF_SLOPE = np.float32(1.2)  # numerical: erf(x) is tanh(1.2 x) to .02
_LEAST_PULL = 0.002  # numerical: less than single precision and noise leave


def find_near_lines(
    lines: FittedLines, reach_px: float
) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]:
    """(one, other): all ordered pairs of different lines closer than about `reach_px`."""
    owner, samples = line_samples(lines.pieces, SAMPLE_PX)
    # Two lines' nearest points have samples within half a spacing: this far at most, as the way
    # between them is across whichever line does not end there.
    radius = float(np.hypot(reach_px, SAMPLE_PX))
    near = point_tree(samples).query_pairs(radius, output_type="ndarray")
    one, other = owner[near[:, 0]], owner[near[:, 1]]
    different = one != other
    one, other = one[different], other[different]
    count = len(owner)
    key = distinct(np.minimum(one, other) * count + np.maximum(one, other))
    one, other = np.divmod(key, max(count, 1))
    return np.divmod(np.sort(np.concatenate([key, other * count + one])), max(count, 1))


class Overlaps(NamedTuple):
    """Points that lie within reach of a line that is not their own.

    Fields
    ------
    point, line : (m,) indices of both.
    along, across : (m,) where the point's sample lies from the centre of the line; the brighter
        side, on the left of the line's direction, counts positive across.
    """

    point: Int[np.ndarray, "m"]
    line: Int[np.ndarray, "m"]
    along: Float[np.ndarray, "m"]
    across: Float[np.ndarray, "m"]


def find_overlaps(
    runs: Runs,
    lines: FittedLines,
    profile_variance_px2: float,
    tuning: ErrorTuning = DEFAULT.errors,
) -> Overlaps:
    """All points within reach of lines that are not their run's own.

    `profile_variance_px2` is that of a typical edge of the image: the reach follows from it.
    """
    points = runs.points
    reach_px = tuning.reach_widths * float(np.sqrt(profile_variance_px2))
    one, other = find_near_lines(lines, reach_px)
    pair, point = expand_ranges(runs.first[one], (runs.first + runs.count)[one])
    # Most points of a line are far from the other one: little is computed of these.
    centre_u, centre_v = lines.centre_px.astype(np.float32)[other].T
    way_u, way_v = lines.direction.astype(np.float32)[other].T
    offset_u = np.take(points.sample_px[:, 0], point) - np.take(centre_u, pair)
    offset_v = np.take(points.sample_px[:, 1], point) - np.take(centre_v, pair)
    across = offset_u * np.take(way_v, pair) - offset_v * np.take(way_u, pair)
    near = np.flatnonzero(np.abs(across) < reach_px)
    pair = pair[near]
    along = offset_u[near] * way_u[pair] + offset_v[near] * way_v[pair]
    before, after = lines.extent_px.astype(np.float32)[other].T
    beside = (along > before[pair] - reach_px) & (along < after[pair] + reach_px)
    near, pair = near[beside], pair[beside]
    return Overlaps(point[near], other[pair], along[beside], across[near])


def without_neighbours(
    points: EdgePoints,
    lines: FittedLines,
    blur_px2: float,
    found: Overlaps,
) -> EdgePoints:
    """The points, located again in profiles from which neighbouring lines are subtracted.

    `blur_px2` is the variance of the blur of the picture's edges. Points of which a neighbour makes
    up most keep next to no weight.
    """
    point, line, along, across = found
    if len(point) == 0:
        return points
    way_u, way_v = (column[line] for column in lines.direction.astype(np.float32).T)
    normal_u, normal_v = (np.take(column, point) for column in points.normal.T)
    before, after = (column[line] for column in lines.extent_px.astype(np.float32).T)
    # The line's normal is (way_v, -way_u), toward its brighter side.
    cosine = way_v * normal_u - way_u * normal_v
    axis, spacing = points.along_u[point], points.spacing_px[point]
    step_along = np.where(axis, way_u, way_v) * spacing
    step_across = np.where(axis, way_v, -way_u) * spacing
    variance = points.kernel_variance_px2[point] + np.float32(blur_px2)
    height = (lines.contrast / np.sqrt(2 * np.pi)).astype(np.float32)[line]
    height *= cosine / np.sqrt(variance)
    height *= lines.light_per_level.astype(np.float32)[line] / points.light_per_level[point]
    halved, tail = -0.5 / variance, -np.float32(_TAIL) / variance**4
    scale = _ERF_SLOPE * np.sqrt(-halved)
    added = np.zeros((3, len(points.strength)), dtype=np.float32)
    for sample, step in enumerate((-1, 0, 1)):
        t, squared = along + step * step_along, np.square(across + step * step_across)
        window = np.tanh((t - before) * scale) - np.tanh((t - after) * scale)
        shape = np.exp(squared * (halved + tail * squared))
        added[sample] = np.bincount(
            point, 0.5 * height * shape * window, minlength=len(points.strength)
        )
    return _relocate_points(points, added)


def _relocate_points(points: EdgePoints, added: Float[np.ndarray, "3 n"]) -> EdgePoints:
    most = np.abs(added).max(axis=0)
    touched = np.flatnonzero(most > _LEAST_PULL * points.profile[:, 1])
    before = points.take(touched)
    profile = before.profile - added[:, touched].T
    middle = profile[:, 1]
    located, variance = before.locate(np.maximum(profile, 1e-3 * middle[:, None]))
    share = middle / before.profile[:, 1]
    # Along one axis of the picture.
    moved = located - before.sample_px
    usable = (
        (np.minimum(profile[:, 0], profile[:, 2]) > LEAST_SIDE * middle)
        & (middle > 0)
        & (np.abs(moved[:, 0] + moved[:, 1]) < FARTHEST * before.spacing_px)
    )
    share = np.where(usable, share, 1e-3)
    uv_px, sharpness = points.uv_px.copy(), points.sharpness.copy()
    strength, information = points.strength.copy(), points.information.copy()
    uv_px[touched[usable]] = located[usable]
    sharpness[touched[usable]] = ((before.kernel_variance_px2 + 1) / variance)[usable]
    strength[touched] = before.profile[:, 1] * share
    # Relative to the profile as measured: the points may have been cleaned before.
    information[touched] = before.information * np.square(
        before.profile[:, 1] * share / before.strength
    )
    return points._replace(
        uv_px=uv_px, sharpness=sharpness, strength=strength, information=information
    )


_PIXEL_VARIANCE = 1 / 12  # numerical: of a box of one pixel


class ErrorModel(NamedTuple):
    """Of each line, what besides noise may have moved it.

    Fields
    ------
    pull_px : (r,) mean shift of the points that was ascribed to neighbours.
    crowded : (r,) share of the points that have a neighbouring line within reach.
    saturated : (r,) share of the points whose bright side is saturated.
    sagitta_px : (r,) deviation from straightness that noise does not explain.
    scatter_px : (r,) root mean square distance of the points from the line, beyond what noise
        explains.
    off_px : (r, 2) how far the last points of each end lie off the line, where noise does not
        explain it: a neighbour has them.
    """

    pull_px: Float[np.ndarray, "r"]
    crowded: Float[np.ndarray, "r"]
    saturated: Float[np.ndarray, "r"]
    sagitta_px: Float[np.ndarray, "r"]
    scatter_px: Float[np.ndarray, "r"]
    off_px: Float[np.ndarray, "r 2"]


def error_model(
    picture: Light,
    measured: EdgePoints,
    cleaned: Runs,
    lines: FittedLines,
    found: Overlaps,
    usual_blur_px2: float,
    tuning: ErrorTuning = DEFAULT.errors,
) -> ErrorModel:
    """Compare the points as measured and after neighbours were taken out.

    `lines` are fitted to the cleaned points.
    """
    bow = np.abs(lines.sagitta_px)
    noise_bow = BOW_OF_MIDDLE * np.sqrt(lines.variance_middle_px2)
    noise_px = tuning.noise_sigmas * np.sqrt(lines.variance_middle_px2 * lines.support)
    shift = (cleaned.points.uv_px - measured.uv_px).astype(np.float64)
    near = np.zeros(len(measured.strength))
    near[found.point] = 1.0
    # A saturated edge looks sharper than it is.
    blur = np.sqrt(np.maximum(lines.blur_px2, usual_blur_px2) + _PIXEL_VARIANCE)
    beside = cleaned.spread(tuning.bright_side_widths * blur).astype(np.float32)
    bright = measured.sample_px + beside[:, None] * measured.normal
    level = nearest_levels(picture.levels, *bright.T)
    return ErrorModel(
        cleaned.mean(np.hypot(shift[:, 0], shift[:, 1])),
        cleaned.mean(near),
        cleaned.mean((level >= picture.white).astype(np.float64)),
        np.where(bow > tuning.noise_sigmas * noise_bow, bow, 0.0),
        np.sqrt(np.maximum(lines.residual_px**2 - noise_px**2, 0.0)),
        _off_line(cleaned, lines, noise_px, tuning.last_points),
    )


def _off_line(
    runs: Runs, lines: FittedLines, least_px: Float[np.ndarray, "r"], last_points: int
) -> Float[np.ndarray, "r 2"]:
    """(r, 2) mean distance of the last points at either end from their line.

    0 where it is less than `least_px` over the root of their number.
    """
    first, count = runs.first[:, None], np.minimum(last_points, runs.count)[:, None]
    steps = np.arange(last_points)
    ends = np.stack([first + steps, first + runs.count[:, None] - 1 - steps], axis=1)
    within = (steps < count)[:, None]
    offset = runs.points.uv_px[np.where(within, ends, first[:, None])]
    offset = offset - lines.centre_px[:, None, None]
    way = lines.direction[:, None, None]
    across = offset[..., 1] * way[..., 0] - offset[..., 0] * way[..., 1]
    mean = np.abs((across * within).sum(axis=2)) / count
    return np.where(mean > least_px[:, None] / np.sqrt(count), mean, 0.0)


def inflate_variance(
    disturbed: ErrorModel,
    noise_px2: Float[np.ndarray, "r"],
    saturated: Shifts,
    shaded: Shifts,
    tuning: ErrorTuning = DEFAULT.errors,
) -> tuple[Float[np.ndarray, "r"], Float[np.ndarray, "r"], Shaped[np.ndarray, "r"]]:
    """(variance of each line's middle across it, variance of what moves it as a whole, what added
    most to them).

    `noise_px2` is the variance from noise alone. Saturation, shading and a neighbour all along move
    a line as a whole. The last is "neighbour", "bent", "saturated" or "shaded" where that adds more
    than noise does, and "" elsewhere.
    """
    crowd_px = tuning.crowd_px * np.square(disturbed.crowded)
    neighbour = np.square(disturbed.pull_px) + np.square(crowd_px)
    bent = np.square(tuning.bow_share * disturbed.sagitta_px)
    bent += np.square(tuning.scatter_share * disturbed.scatter_px)
    parts = np.stack([neighbour, bent, saturated.variance_px2, shaded.variance_px2])
    names = np.array(["neighbour", "bent", "saturated", "shaded"])
    reasons = np.where(parts.max(axis=0) > noise_px2, names[parts.argmax(axis=0)], "")
    # Where a line has its neighbour all along, that moves it more than it turns it.
    beside = disturbed.crowded * neighbour
    turning = neighbour - (1 - tuning.turn_share) * beside
    common = beside + saturated.variance_px2 + shaded.variance_px2
    return noise_px2 + bent + turning, common, reasons


def noise_variance(
    variance_middle_px2: Float[np.ndarray, "r"],
    length_px: Float[np.ndarray, "r"],
    tuning: ErrorTuning = DEFAULT.errors,
) -> Float[np.ndarray, "r"]:
    """(r,) variance of a line's middle across it, where nothing but noise disturbs it."""
    independent = tuning.model_sigma_per_pixel**2 / np.maximum(length_px, 1.0)
    model = tuning.model_sigma_px**2 + independent
    return tuning.noise_excess * variance_middle_px2 + model


def end_covariances(
    direction: Float[np.ndarray, "r 2"],
    variance_middle: Float[np.ndarray, "r"],
    common_px2: Float[np.ndarray, "r"],
    off_px2: Float[np.ndarray, "r 2"],
    sigma_along_px: Float[np.ndarray, "r 2"],
) -> Float[np.ndarray, "r 4 4"]:
    """(r, 4, 4) covariance of the ends (u1, v1, u2, v2).

    A line fitted to points spread evenly over its length L has an angle of variance
    12 / L^2 times that of its middle: each end has four times the variance across, and
    the two are correlated by -1/2. What moves the line as a whole, of variance `common_px2`,
    moves both ends alike; `off_px2` is what each end may be off by itself. Along the line the two
    ends are independent.
    """
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=-1)
    across = normal[:, :, None] * normal[:, None, :]
    along = direction[:, :, None] * direction[:, None, :]
    covariance = np.zeros((len(direction), 4, 4))
    for end, block in ((0, slice(0, 2)), (1, slice(2, 4))):
        covariance[:, block, block] = (4 * variance_middle + common_px2 + off_px2[:, end])[
            :, None, None
        ] * across + np.square(sigma_along_px[:, end])[:, None, None] * along
    between = (common_px2 - 2 * variance_middle)[:, None, None] * across
    covariance[:, :2, 2:] = covariance[:, 2:, :2] = between
    return covariance
