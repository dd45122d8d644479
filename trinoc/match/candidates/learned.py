"""What a sample of the segments tells of all: where lines lie, and which candidates are likely."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from trinoc.match.candidates.region import Region
from trinoc.match.candidates.single_precision import in_single
from trinoc.match.evidence import MixtureParameters, end_evidence, triple_evidence
from trinoc.match.observations import TRIPLES_IN_BLOCK, ClutterModel, SegmentTable, block_of
from trinoc.match.tuning import CandidateTuning, EndTuning, EvidenceTuning, MatchTuning
from trinoc.match.two_view import Pencil, cut_pair, points_of, row_of, sight_of
from trinoc.numerics import ArrayLike, in_blocks, kept_jit


class Learned(NamedTuple):
    """Where to search, everywhere where None, and the parameters of the evidence.

    least_log_odds : what is less likely than this, about, is no candidate.
    ends_px : pairs of which no end agrees as nearly as this are left out; None leaves out none.
    """

    region: Region | None
    mixture: MixtureParameters
    least_log_odds: float
    ends_px: float | None = None


class Screen(NamedTuple):
    """The segments of one order of the views in single precision, about the first camera."""

    lines: SegmentTable
    order: Int[np.ndarray, "3"]
    planes: Pencil
    clutter: ClutterModel


def screen_of(
    lines: SegmentTable, order: Int[np.ndarray, "3"], planes: Pencil, clutter: ClutterModel
) -> Screen:
    """What `likely_triples` needs, of one frame."""
    # Coordinates from the first camera on, which single precision holds wherever the world begins.
    matrix, origin = np.asarray(lines.matrix_px), np.asarray(planes.origin_mm)
    moved = matrix[..., :3] @ origin + matrix[..., 3]
    lines = lines._replace(
        matrix_px=np.concatenate([matrix[..., :3], moved[..., None]], axis=-1),
        centre_mm=np.asarray(lines.centre_mm) - origin,
    )
    planes = planes._replace(origin_mm=np.zeros(3))
    single = jax.tree.map(in_single, (lines, order, planes, clutter))
    return Screen(*jax.device_put(single))


def likely_triples(
    screen: Screen, triple: Int[np.ndarray, "h 3"], learned: Learned, tuning: MatchTuning
) -> Int[np.ndarray, "_ 3"]:
    """Those triples of one frame that may be likely, wherever they lie.

    They are judged on the line of their pair, without the fit to all three, and as if darker sides
    agreed. Where side levels are known, all may be.
    """
    if np.isfinite(np.asarray(screen.lines.sides)).any():
        return triple
    mixture = learned.mixture
    shares = (np.log(share).astype(np.float32) for share in (mixture.tail, mixture.ends))
    tail, ends = shares
    prior = mixture.log_count - mixture.volume.log_size - np.log(2 * np.pi)
    prior += tuning.evidence.log_odds_offset
    if np.asarray(screen.lines.polarity).any():
        prior += 2 * np.log(2)

    def odds(rows: np.ndarray) -> ArrayLike:
        groups = {"tuning": tuning.candidates, "of_ends": tuning.ends, "evidence": tuning.evidence}
        return _log_odds(*screen, rows, (tail, ends), **groups)

    found = in_blocks(odds, block_of(screen.lines, TRIPLES_IN_BLOCK), triple)
    return triple[found + prior > learned.least_log_odds]


@partial(kept_jit, static_argnames=("tuning", "of_ends", "evidence"))
def _log_odds(
    lines: SegmentTable,
    order: Int[ArrayLike, "3"],
    planes: Pencil,
    clutter: ClutterModel,
    triple: Int[ArrayLike, "h 3"],
    log_shares: tuple[Float[ArrayLike, "k"], Float[ArrayLike, "c"]],
    tuning: CandidateTuning,
    of_ends: EndTuning,
    evidence: EvidenceTuning,
) -> Float[ArrayLike, "h"]:
    """Log odds of each apart from the prior, -inf where it cannot be one line."""
    segments = triple.T
    sight = sight_of(lines, clutter, order, segments)
    rows = row_of(planes.first, segments[0]), row_of(planes.second, segments[1])
    near_mm = points_of(planes, cut_pair(planes.baseline_mm, *rows, tuning))
    found = triple_evidence(sight, near_mm, tuning)
    tail, shares = log_shares
    total = found.log_density + _log_tail(found.chi_square, tail, evidence)
    for terms in end_evidence(found.extent_px, of_ends):
        mixed = [share + term for share, term in zip(shares, terms, strict=True)]
        total += jax.nn.logsumexp(jnp.stack(mixed), axis=0)
    return jnp.where(found.possible, total, -jnp.inf)


def _log_tail(
    chi_square: Float[ArrayLike, "h"], log_shares: Float[ArrayLike, "k"], tuning: EvidenceTuning
) -> Float[ArrayLike, "h"]:
    terms = [
        log_share - float(np.log(2 * np.pi * scale**2)) - chi_square / (2 * scale**2)
        for log_share, scale in zip(log_shares, tuning.tail_scales, strict=True)
    ]
    return jax.nn.logsumexp(jnp.stack(terms), axis=0)
