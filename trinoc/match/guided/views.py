"""The pictures of a rig as probes see them, and what they answer."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Shaped

from trinoc.geometry import Intrinsics, Rig
from trinoc.match.guided.evidence import Evidence, evidence_along
from trinoc.match.guided.false_alarms import block_noise, growth_of, log_chance
from trinoc.match.guided.gradient import gradient_of
from trinoc.match.guided.probes import samples_of, step_of
from trinoc.match.guided.ridges import REACH
from trinoc.match.observations import distorted
from trinoc.numerics import bucket, in_blocks

AT_ONCE = 512
_LOOKS = 16
# Of the place across, what noise does not explain: sampling and interpolation, px; and the share
# of the slope between both shoulders that moves the ridge.
_FLOOR_PX, _PULL = 0.06, 0.6


class PictureInput(NamedTuple):
    """Fields
    ------
    by_uv : (h, w, 2) gradient.
    noise : standard deviation of the gradient from noise.
    least : the same of one block's ridge.
    growth : (k,) what windows of correlated noise sum up to, see `false_alarms.py`.
    """

    name: str
    matrix_px: Float[np.ndarray, "3 4"]
    lens: Intrinsics
    size_px: tuple[int, int]
    by_uv: Float[np.ndarray, "h w 2"]
    noise: float
    least: np.float32
    growth: Float[np.ndarray, "k"]


class Answer(NamedTuple):
    """What a picture answers to probes.

    Fields
    ------
    log_chance : (n,) logarithm of the probability that noise shows as much in the best of all
        tests of this probe (at most 0).
    log_one : (n,) the same of one test.
    sign : (n,) +1 where it is brighter on the right of the way.
    ends_px : (n, 2, 2) ends of the edge, undistorted.
    covariance_px2 : (n, 4, 4) of them.
    along_px : (n, 2) where the ends lie along the probe.
    contrast : (n,) grey levels of the step. tests : (n,) how many were made.
    covered : (n,) share of the probe that the edge covers.
    """

    log_chance: Float[np.ndarray, "n"]
    log_one: Float[np.ndarray, "n"]
    sign: Float[np.ndarray, "n"]
    ends_px: Float[np.ndarray, "n 2 2"]
    covariance_px2: Float[np.ndarray, "n 4 4"]
    along_px: Float[np.ndarray, "n 2"]
    contrast: Float[np.ndarray, "n"]
    tests: Float[np.ndarray, "n"]
    covered: Float[np.ndarray, "n"]

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
        gradient = gradient_of(picture)
        lens, size = rig[name].intrinsics, rig[name].image_size_px
        found.append(
            PictureInput(
                name,
                np.asarray(rig[name].matrix_px),
                lens,
                size,
                gradient.by_uv,
                gradient.noise,
                np.float32(max(block_noise(gradient), 1e-3)),
                growth_of(gradient, lens, size),
            )
        )
    return found


def plausible(
    picture: PictureInput, ends_px: Float[np.ndarray, "n 2 2"], share: float, sigmas: float
) -> Bool[np.ndarray, "n"]:
    """Whether there is any gradient near a share of the places along each probe: a quick look."""
    way = ends_px[:, 1] - ends_px[:, 0]
    unit = way / np.maximum(np.linalg.norm(way, axis=1), 1e-9)[:, None]
    right = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    along, across = (np.arange(_LOOKS) + 0.5) / _LOOKS, np.arange(-REACH, REACH + 1)
    middle = ends_px[:, None, :1] + along[:, None, None] * way[:, None, None]
    places = middle + across[:, None] * right[:, None, None]
    places = distorted(picture.lens, places.reshape(-1, 2, 2))
    column, row = np.rint(places).astype(np.int64).reshape(len(way), -1, 2).transpose(2, 0, 1)
    height, width = picture.by_uv.shape[:2]
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    found = picture.by_uv[np.where(inside, row, 0), np.where(inside, column, 0)]
    steep = np.abs((found * right[:, None]).sum(axis=2)) > sigmas * picture.noise
    near = (steep & inside).reshape(len(way), _LOOKS, -1).any(axis=2)
    seen = inside.reshape(len(way), _LOOKS, -1).all(axis=2)
    return near.sum(axis=1) >= np.maximum(share * seen.sum(axis=1), 2)


def ask(
    picture: PictureInput,
    ends_px: Float[np.ndarray, "n 2 2"],
    gate_px: Float[np.ndarray, "n"],
    near_px: Float[np.ndarray, "n"],
    latest_px: Float[np.ndarray, "n"],
) -> Answer:
    """The best edge along each probe that begins at most `latest_px` after the probe does."""
    places = samples_of(ends_px, picture.lens, picture.size_px)
    block_px = 2 * step_of(ends_px)
    latest = np.floor(np.minimum(latest_px / block_px, 99)).astype(np.int32)

    def along(*columns: np.ndarray) -> Evidence:
        growth = picture.growth.astype(np.float32)
        return evidence_along(picture.by_uv, picture.least, growth, *columns)

    columns = places.uv_px, places.normal, places.inside, gate_px, near_px, latest
    dtypes = np.float32, np.float32, np.bool_, np.float32, np.float32, np.int32
    size = min(bucket(len(ends_px)), AT_ONCE)
    found = in_blocks(along, size, *(c.astype(d) for c, d in zip(columns, dtypes, strict=True)))
    return _answer(ends_px, block_px, Evidence(*(np.asarray(c, np.float64) for c in found)))


def _answer(
    ends_px: Float[np.ndarray, "n 2 2"], block_px: Float[np.ndarray, "n"], found: Evidence
) -> Answer:
    way = ends_px[:, 1] - ends_px[:, 0]
    unit = way / np.maximum(np.linalg.norm(way, axis=1), 1e-9)[:, None]
    right = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    along = np.stack([found.first, found.last], axis=1) * block_px[:, None]
    # The line through the middles of both halves.
    count = np.maximum(found.last - found.first, 1)
    split = found.first + (count + 1) // 2
    middle = np.stack([found.first + split, split + found.last], axis=1) / 2 * block_px[:, None]
    apart = np.maximum(middle[:, 1] - middle[:, 0], 1e-9)
    share = (along - middle[:, :1]) / apart[:, None]
    weight = np.stack([1 - share, share], axis=2)
    across = (weight @ found.offset_px[:, :, None])[..., 0]
    own = np.asarray(found.variance_px2) + _FLOOR_PX**2
    own += (_PULL * np.clip(np.abs(found.asymmetry) - 0.2, 0.0, 2.0))[:, None] ** 2
    spread = np.einsum("nij,nj,nkj->nik", weight, own, weight)
    end_sigma = np.asarray(found.end_sigma) * block_px[:, None]
    covariance = np.einsum("nef,ni,nj->neifj", spread, right, right)
    for end in (0, 1):
        covariance[:, end, :, end] += (end_sigma[:, end] ** 2)[:, None, None] * (
            unit[:, :, None] * unit[:, None, :]
        )
    places = ends_px[:, :1] + along[..., None] * unit[:, None] + across[..., None] * right[:, None]
    one = np.where(
        found.score > 0, log_chance(np.asarray(found.score), np.asarray(found.excess)), 0.0
    )
    chance = np.minimum(one + np.log(np.maximum(found.tests, 1.0)), 0.0)
    return Answer(
        chance,
        one,
        np.asarray(found.sign),
        places,
        covariance.reshape(-1, 4, 4),
        along,
        np.asarray(found.contrast),
        np.asarray(found.tests),
        (along[:, 1] - along[:, 0]) / np.maximum(np.linalg.norm(way, axis=1), 1e-9),
    )
