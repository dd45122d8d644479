"""The pictures of a rig as probes see them, and what they answer."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped

from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.match.pixels.evidence import WindowEvidence, search_windows
from trinoc.match.pixels.probes import (
    NEXT,
    SECOND,
    SHOULDER,
    STEP_PX,
    STEPS,
    WINDOW_SIZE,
    WINDOWS,
    PictureGradient,
    picture_gradient,
    probe_steps_px,
    sample_probes,
    window_scores,
)
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.numerics.tables import concatenate_rows
from trinoc.numerics.tails import MAD_TO_SIGMA, log_normal_tail, log_student_tail

# numerical: probes at once, so that what is read of the picture stays near the processor.
AT_ONCE = 128


class PictureInput(NamedTuple):
    """Fields
    ------
    by_uv : (2, h, w) gradient.
    noise : standard deviation of the gradient from noise.
    least : the same of one block's ridge.
    growth : (k,) what windows of correlated noise sum up to, see `measure_growth`.
    usual_px : how wide the ridges of edges are here, see `with_usual_width`; infinite where nobody
        knows.
    """

    name: str
    matrix_px: Float[np.ndarray, "3 4"]
    lens: Intrinsics
    size_px: tuple[int, int]
    by_uv: Float[np.ndarray, "2 h w"]
    noise: float
    least: float
    growth: Float[np.ndarray, "k"]
    usual_px: float = np.inf


class EdgeResponse(NamedTuple):
    """What a picture answers to probes.

    Fields
    ------
    log_chance : (n,) logarithm of the probability that noise shows as much in the best of all
        tests of this probe (at most 0).
    sign : (n,) +1 where it is brighter on the right of the way.
    ends_px : (n, 2, 2) ends of the edge, undistorted.
    covariance_px2 : (n, 4, 4) of them.
    along_px : (n, 2) where the ends lie along the probe.
    width_px : (n, 2) of its ridge, in the first and the second half.
    contrast : (n,) grey levels of the step. tests : (n,) how many were made.
    """

    log_chance: Float[np.ndarray, "n"]
    sign: Float[np.ndarray, "n"]
    ends_px: Float[np.ndarray, "n 2 2"]
    covariance_px2: Float[np.ndarray, "n 4 4"]
    along_px: Float[np.ndarray, "n 2"]
    width_px: Float[np.ndarray, "n 2"]
    contrast: Float[np.ndarray, "n"]
    tests: Float[np.ndarray, "n"]

    @property
    def length_px(self) -> Float[np.ndarray, "n"]:
        """From end to end."""
        return self.along_px[:, 1] - self.along_px[:, 0]


def picture_inputs(
    rig: Rig, pictures: Mapping[str, Shaped[np.ndarray, "..."]]
) -> list[PictureInput]:
    """Gradients and noise of all pictures."""
    found = []
    for name, picture in pictures.items():
        gradient = picture_gradient(picture)
        lens, size = rig[name].intrinsics, rig[name].image_size_px
        found.append(
            PictureInput(
                name,
                np.asarray(rig[name].matrix_px),
                lens,
                size,
                gradient.by_uv,
                gradient.noise,
                max(block_noise(gradient), 1e-3),
                measure_growth(gradient, lens, size),
            )
        )
    return found


def ask(
    picture: PictureInput,
    ends_px: Float[np.ndarray, "n 2 2"],
    gate_px: Float[np.ndarray, "n"],
    near_px: Float[np.ndarray, "n"],
    latest_px: Float[np.ndarray, "n"],
) -> EdgeResponse:
    """The best edge along each probe that begins at most `latest_px` after the probe does."""
    block_px = 2 * probe_steps_px(ends_px)
    latest = np.floor(np.minimum(latest_px / block_px, 99)).astype(np.int64)
    found = []
    for start in range(0, len(ends_px), AT_ONCE):
        rows = slice(start, start + AT_ONCE)
        places = sample_probes(ends_px[rows], picture.lens, picture.size_px)
        columns = gate_px[rows], near_px[rows], latest[rows]
        one = search_windows(picture.by_uv, picture.least, picture.growth, places, *columns)
        found.append(one._replace(probe=one.probe + start))
    if not found:
        return _nothing(0)
    whole = concatenate_rows(found)
    return spread_out(
        _answer(picture.usual_px, ends_px[whole.probe], block_px[whole.probe], whole),
        whole.probe,
        len(ends_px),
    )


def spread_out(answer: EdgeResponse, rows: Int[np.ndarray, "n"], count: int) -> EdgeResponse:
    """Answers of some of `count` probes, among those that show nothing."""
    whole = _nothing(count)
    for column, own in zip(whole, answer, strict=True):
        column[rows] = own
    return whole


def _nothing(count: int) -> EdgeResponse:
    shapes = (), (), (2, 2), (4, 4), (2,), (2,), (), ()
    return EdgeResponse(*(np.zeros((count, *shape)) for shape in shapes))


def _answer(
    usual_px: float,
    ends_px: Float[np.ndarray, "n 2 2"],
    block_px: Float[np.ndarray, "n"],
    found: WindowEvidence,
) -> EdgeResponse:
    way = ends_px[:, 1] - ends_px[:, 0]
    length = np.maximum(np.linalg.norm(way, axis=1), 1e-9)
    unit = way / length[:, None]
    right = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    extent, place = found.extent, found.place
    along = np.stack([extent.first, extent.last], axis=1) * block_px[:, None]
    # The line through the middles of both halves.
    middle = place.middle * block_px[:, None]
    apart = np.maximum(middle[:, 1] - middle[:, 0], 1e-9)
    share = (along - middle[:, :1]) / apart[:, None]
    weight = np.stack([1 - share, share], axis=2)
    across = (weight @ place.offset_px[:, :, None])[..., 0]
    # A ridge wider than usual may hold another edge, which moves it by a part of its width.
    wider = np.log(np.maximum(place.width_px / usual_px, 1.0))
    own = place.variance_px2 + (place.width_px * wider) ** 2
    spread = np.einsum("nij,nj,nkj->nik", weight, own, weight)
    end_sigma = extent.sigma * block_px[:, None]
    covariance = np.einsum("nef,ni,nj->neifj", spread, right, right)
    for end in (0, 1):
        covariance[:, end, :, end] += (end_sigma[:, end] ** 2)[:, None, None] * (
            unit[:, :, None] * unit[:, None, :]
        )
    places = ends_px[:, :1] + along[..., None] * unit[:, None] + across[..., None] * right[:, None]
    one = log_chance(found.score, found.excess)
    return EdgeResponse(
        np.minimum(one + np.log(np.maximum(found.tests, 1.0)), 0.0),
        found.sign,
        places,
        covariance.reshape(-1, 4, 4),
        along,
        place.width_px,
        place.contrast,
        found.tests,
    )


def with_usual_width(
    picture: PictureInput, segments_px: Float[np.ndarray, "n 2 2"]
) -> PictureInput:
    """The picture with the median width of the ridges on its segments (undistorted pixels).

    A sliver of a face, or the shadow under an edge, that is narrower than the blur makes one ridge
    of two edges, whose top lies between them. That it is wider than others is its only sign.
    """
    gate = np.ones(len(segments_px))
    answer = ask(picture, segments_px, gate, gate / 2, np.full(len(gate), np.inf))
    width = answer.width_px[answer.contrast > 0]
    return picture._replace(usual_px=float(np.median(width)) if width.size else np.inf)


# numerical: how many control probes measure the noise.
CONTROLS = 128


def block_noise(gradient: PictureGradient) -> float:
    """Standard deviation of a block's ridge from the noise of the picture, at the least step."""
    wide = DEFAULT.guided.smoothing_px
    along = np.exp(-((STEP_PX / wide) ** 2) / 4)

    def interpolate_across(apart: float) -> float:
        return float((1 - apart**2 / (2 * wide**2)) * np.exp(-((apart / wide) ** 2) / 4))

    shoulders = 1.5 - 2 * interpolate_across(SHOULDER) + 0.5 * interpolate_across(2 * SHOULDER)
    return float(gradient.noise * np.sqrt((1 + along) / 2 * shoulders))


def measure_growth(
    gradient: PictureGradient, lens: Intrinsics, size_px: tuple[int, int], controls: int = CONTROLS
) -> Float[np.ndarray, "k"]:
    """g(n) for every size of window, at least that of white noise, from control probes."""
    rng = np.random.default_rng(0)
    size = np.array(size_px, dtype=np.float64)
    length = min(STEPS * STEP_PX, 0.6 * float(size.min()))
    middle = rng.uniform(0.35 * length, size - 0.35 * length, (controls, 2))
    angle = rng.uniform(0, np.pi, controls)
    half = 0.5 * length * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    places = sample_probes(np.stack([middle - half, middle + half], axis=1), lens, size_px)
    scores, complete = window_scores(gradient.by_uv, max(block_noise(gradient), 1e-3), places)
    growth = white_growth()
    for k, window in enumerate(WINDOWS):
        column = window == WINDOW_SIZE
        values = np.abs(scores[:, column][complete[:, column]])
        if len(values) > 20:
            growth[k] = max(growth[k], (MAD_TO_SIGMA * np.median(values)) ** 2)
    return np.maximum.accumulate(growth)


def white_growth() -> Float[np.ndarray, "k"]:
    """g(n) of white noise: neighbouring blocks share a little of it."""
    sizes = np.array(WINDOWS, dtype=np.float64)
    return 1 + 2 * NEXT * (sizes - 1) / sizes + 2 * SECOND * (sizes - 2) / sizes


def log_chance(score: Float[np.ndarray, "n"], excess: Float[np.ndarray, "n"]) -> np.ndarray:
    """Natural logarithm of the probability that noise scores as much in one test, two-sided.

    Where blocks scatter as the picture's noise says, their sigma is known; where they scatter more
    (`excess`), it is an estimate from few, and the score is one of Student's.
    """
    known = log_normal_tail(score)
    estimated = log_student_tail(score, DEFAULT.guided.block_degrees)
    return np.log(2) + np.where(
        excess > DEFAULT.guided.known_below, np.maximum(estimated, known), known
    )
