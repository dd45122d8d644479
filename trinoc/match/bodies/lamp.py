"""The lamp that most lines agree on: a vote of every line that may be a shadow of another."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.match.bodies.casting import Lamps, ShadowPairs, cast_density, likely_casts
from trinoc.match.tuning.bodies import ShadowTuning
from trinoc.numerics.buckets import blocks
from trinoc.numerics.tables import concatenate_rows, take_rows
from trinoc.numerics.vectors import complete_axes

# numerical: lamps that are judged at once, so that tables of pairs stay in the cache.
AT_ONCE = 128
# numerical: lamps that are pursued.
PEAKS = 10
# numerical: of a coarse step: how sharp the last search is, and what counts as another lamp.
FINE, APART = 0.1, 2.0


class Votes(NamedTuple):
    """What lines say of lamps.

    prior : of each line, that it is a shadow. weight : of each pair, that its edge is one.
    mean : of each line's density over all lamps, by which it is a likelihood ratio.
    """

    pairs: ShadowPairs
    prior: Float[np.ndarray, "e"]
    weight: Float[np.ndarray, "p"]
    size_mm: float
    mean: Float[np.ndarray, "e"] | None = None

    def ratios(
        self, lamps: Lamps, turn_deg: float, tuning: ShadowTuning
    ) -> Float[np.ndarray, "l e"]:
        """Likelihood of each line as a shadow of each lamp, over that of any lamp."""
        found = np.zeros((len(lamps.nearness), len(self.prior)))
        turn = float(np.radians(turn_deg))
        for part in blocks(len(found), AT_ONCE) if len(self.weight) else ():
            some = take_rows(lamps, part)
            lamp, pair = likely_casts(self.pairs, some, turn, self.size_mm, tuning)
            chosen = take_rows(self.pairs, pair)
            density = cast_density(chosen, take_rows(some, lamp), turn, self.size_mm, tuning)
            place = lamp * len(self.prior) + chosen.shadow
            votes = np.bincount(place, density * self.weight[pair], found[part].size)
            found[part] = votes.reshape(-1, len(self.prior))
        return found if self.mean is None else found / self.mean

    def scores(self, ratios: Float[np.ndarray, "l e"], tuning: ShadowTuning) -> np.ndarray:
        """Log likelihood of each lamp over that of none."""
        gain = (1 - tuning.unexplained) * (ratios - 1)
        return np.log1p(self.prior * gain).sum(axis=1)


class Lamp(NamedTuple):
    """The best lamp. score : its log likelihood over none. covariance : of its turn about two axes
    across (`complete_axes`), rad, and of its nearness, per mm. ratios : of lines, see `Votes`."""

    direction: Float[np.ndarray, "3"]
    nearness: float
    covariance: Float[np.ndarray, "3 3"]
    score: float
    ratios: Float[np.ndarray, "e"]


def best_lamp(votes: Votes, upward: Float[np.ndarray, "3"], tuning: ShadowTuning) -> Lamp:
    """The lamp of the highest score above a plane, from a coarse search to a fine one."""
    step, size = tuning.coarse_deg, votes.size_mm
    directions = _above(upward, step, tuning)
    far = np.repeat([0.0, tuning.nearest / 2], len(directions)) / size
    lamps = Lamps(np.tile(directions, (2, 1)), far)
    density = votes.ratios(lamps, step / 2, tuning)
    votes = votes._replace(mean=density.mean(axis=0) + 1e-12)
    scores = votes.scores(density / votes.mean, tuning)
    peaks = _peaks(lamps, scores, PEAKS, 1.5 * step)
    change = tuning.nearest / 2
    for _ in range(3):
        step, change = step / 2.5, change / 2
        rows, values = [], []
        for row in peaks:
            around = _around(take_rows(lamps, np.array([row])), step, change / size, 2, 1)
            inside = np.arcsin(np.clip(around.direction @ upward, -1, 1))
            # The peak itself may lie on the bound: rounding is allowed for.
            inside = np.abs(np.degrees(inside) - 45) <= 45 - tuning.margin_deg + 1e-6
            inside &= around.nearness <= tuning.nearest / size * (1 + 1e-9)
            around = take_rows(around, np.flatnonzero(inside))
            found = votes.scores(votes.ratios(around, step / 2, tuning), tuning)
            best = int(np.argmax(found))
            rows.append(take_rows(around, np.array([best])))
            values.append(found[best])
        lamps = concatenate_rows(rows)
        scores = np.array(values)
        peaks = _peaks(lamps, scores, max(len(peaks) // 2, 2), APART * tuning.coarse_deg)
    return _mean_lamp(votes, take_rows(lamps, peaks[:1]), step, change / size, tuning)


def _mean_lamp(votes: Votes, best: Lamps, step: float, change: float, tuning: ShadowTuning) -> Lamp:
    """The mean of the lamps about the best one, by their likelihood, and its spread."""
    for _ in range(2):
        around = _around(best, step / 2, change, 4, 3)
        score = votes.scores(votes.ratios(around, FINE * tuning.coarse_deg, tuning), tuning)
        weight = np.exp(score - score.max())
        weight /= weight.sum()
        mean = weight @ around.direction
        best = Lamps((mean / np.linalg.norm(mean))[None], (weight @ around.nearness)[None])
        step, change = step / 2, change / 2
    off = np.column_stack(
        [around.direction @ complete_axes(best.direction[0]).T, around.nearness - best.nearness]
    )
    covariance = (off * weight[:, None]).T @ off
    # No finer than the lamps that were tried.
    covariance += np.diag([np.radians(step) ** 2 / 3] * 2 + [change**2 / 3])
    ratios = votes.ratios(best, FINE * tuning.coarse_deg, tuning)
    top = float(votes.scores(ratios, tuning)[0])
    return Lamp(best.direction[0], float(best.nearness[0]), covariance, top, ratios[0])


def _above(upward: np.ndarray, step_deg: float, tuning: ShadowTuning) -> np.ndarray:
    """Directions about `step_deg` apart, neither too low nor straight above a plane."""
    rows = [np.zeros((0, 3))]
    across = complete_axes(upward)
    margin = tuning.margin_deg
    for height in np.radians(np.arange(margin, 90 - margin + 1e-9, step_deg)):
        number = max(int(np.ceil(2 * np.pi * np.cos(height) / np.radians(step_deg))), 1)
        angle = 2 * np.pi * np.arange(number) / number
        round_it = np.stack([np.cos(angle), np.sin(angle)], axis=1) @ across
        rows.append(np.cos(height) * round_it + np.sin(height) * upward)
    return np.concatenate(rows)


def _around(lamp: Lamps, step_deg: float, change: float, wide: int, deep: int) -> Lamps:
    """A grid of lamps about one."""
    turn = np.arange(-wide, wide + 1) * np.radians(step_deg)
    one, other = np.meshgrid(turn, turn, indexing="ij")
    across = complete_axes(lamp.direction[0])
    direction = lamp.direction[0] + np.stack([one.ravel(), other.ravel()], axis=1) @ across
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    near = np.unique(np.maximum(lamp.nearness[0] + np.arange(-deep, deep + 1) * change, 0.0))
    return Lamps(np.tile(direction, (len(near), 1)), np.repeat(near, len(direction)))


def _peaks(lamps: Lamps, scores: np.ndarray, most: int, apart_deg: float) -> np.ndarray:
    """The best lamps that are so far apart in direction, the best first."""
    left, found = np.ones(len(scores), dtype=bool), []
    while left.any() and len(found) < most:
        best = int(np.argmax(np.where(left, scores, -np.inf)))
        found.append(best)
        left &= lamps.direction @ lamps.direction[best] < np.cos(np.radians(apart_deg))
        left[best] = False
    return np.array(found, dtype=np.int64)
