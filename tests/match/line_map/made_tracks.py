"""Matches of lines in three views, with errors drawn from their covariances."""

import jax
import numpy as np

from trinoc.geometry import triangulate_segment
from trinoc.geometry.rig import Rig
from trinoc.match import MatchTuning, join_collinear
from trinoc.match.line_map.lines import JoinedLines
from trinoc.match.tracks.matches import TRINOCULAR, Matches
from trinoc.numerics.tables import with_field

VIEWS = ("upper", "left", "right")
_triangulated = jax.jit(jax.vmap(triangulate_segment, in_axes=(None, 0, 0, 0)))
ROOM = 128
# For segments that err as they say, whatever those of pictures do.
AS_STATED = with_field(MatchTuning(), "collinear.error_shares", (1 - 2e-9, 1e-9, 1e-9))


def fitted_covariance(ends_px: np.ndarray, sigma_px: float) -> np.ndarray:
    """(n, 4, 4) covariances of lines fitted to one point per pixel, with `sigma_px` each."""
    direction = ends_px[:, 1] - ends_px[:, 0]
    length = np.linalg.norm(direction, axis=1)
    direction = direction / length[:, None]
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    across = np.array([[4.0, -2.0], [-2.0, 4.0]]) * (sigma_px**2 / length)[:, None, None]
    spread = np.einsum("nef,ni,nj->neifj", across, normal, normal)
    along = np.einsum("ef,ni,nj->neifj", np.eye(2), direction, direction)
    return (spread + along).reshape(-1, 4, 4)


def tracks_of(
    rig: Rig, lines_mm: np.ndarray, *, sigma_px: float = 0.5, seed: int | None = None
) -> Matches:
    """A track of three segments for every line, with errors drawn from their covariances."""
    count = len(lines_mm)
    fragments, covariance = np.zeros((count, 3, 2, 2)), np.zeros((count, 3, 4, 4))
    rng = np.random.default_rng(seed)
    for view, name in enumerate(VIEWS):
        matrix = rig[name].matrix_px
        image = lines_mm @ matrix[:, :3].T + matrix[:, 3]
        ends = image[..., :2] / image[..., 2:]
        covariance[:, view] = fitted_covariance(ends, sigma_px)
        noise = np.linalg.cholesky(covariance[:, view]) @ rng.normal(size=(count, 4, 1))
        fragments[:, view] = ends + (0 if seed is None else noise.reshape(-1, 2, 2))
    return matches_of(rig, np.repeat(np.arange(count)[:, None], 3, axis=1), fragments, covariance)


def matches_of(
    rig: Rig, index: np.ndarray, fragments: np.ndarray, covariance: np.ndarray
) -> Matches:
    count = len(index)
    assert 0 < count <= ROOM
    rows = np.minimum(np.arange(ROOM), count - 1)
    matrices = np.stack([rig[name].matrix_px for name in VIEWS])
    triangulated = _triangulated(matrices, fragments[rows], covariance[rows], index[rows] >= 0)
    return Matches(
        VIEWS,
        index,
        fragments,
        np.asarray(triangulated.ends_mm)[:count],
        np.asarray(triangulated.covariance_mm2)[:count],
        np.full(count, TRINOCULAR),
        np.ones(count),
        np.zeros(count),
        {},
        {},
        covariance,
    )


def pieces_of(lines_mm: np.ndarray, *borders: tuple[float, float]) -> np.ndarray:
    """Parts of all lines, from 0 to 1 along each: the first parts of all, then the second parts."""
    parts = [
        lines_mm[:, :1] + np.array(b)[:, None] * (lines_mm[:, 1:] - lines_mm[:, :1])
        for b in borders
    ]
    return np.concatenate(parts)


def lines_alone(matches: Matches, rig: Rig) -> JoinedLines:
    joined = join_collinear(matches, rig, tuning=AS_STATED)
    assert len(joined) == len(matches)
    return joined
