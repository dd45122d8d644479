"""Where lines lie, learned from two views alone: profiles along the axes of their spread.

A wrong pair lies anywhere along its viewing rays, before the scene and behind it. No third view
says so, but right ones lie where the others do. A box of their spread, which is enough for triples,
is too coarse for that: the wrong ones among them make it larger.
"""

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.evidence import Volume
from trinoc.match.tuning import OcclusionTuning
from trinoc.numerics import broadcast_groups, group_sums

# Shares of a line's weight in its own bin of a profile and in each of the two beside it.
_OWN, _BESIDE = 0.5, 0.25


def log_place_among(
    ends_mm: Float[np.ndarray, "m 2 3"],
    posterior: Float[np.ndarray, "m"],
    volume: Volume,
    tuning: OcclusionTuning,
    frame: Int[np.ndarray, "m"] | None = None,
) -> Float[np.ndarray, "m"]:
    """Log density of a line at each place, per volume (mm^3) and direction (of 2 pi).

    The density is that of the other lines, weighted by their posteriors: a line alone somewhere
    does not say that lines lie there. It is a product of profiles along the axes of `volume`, and
    of a line the geometric mean of that at its ends.
    """
    # The directions of the axes, and standard deviations along them.
    square, turn = np.linalg.eigh(volume.precision)
    axes = np.sqrt(square)[..., None] * turn.mT
    place = _bins(
        ends_mm,
        broadcast_groups(volume.centre_mm, frame),
        broadcast_groups(axes, frame),
        tuning,
    )
    width, usual = _empty_profile(tuning)
    frames, prior = np.size(volume.log_size), tuning.prior_observations
    others = broadcast_groups(group_sums(posterior, frame, frames), frame) - posterior
    # Of the volume that coordinates of unit variance span, to that in mm^3.
    total = broadcast_groups(0.5 * np.log(square).sum(axis=-1), frame) - np.log(2 * np.pi)
    for axis in range(3):
        first, second = place[:, :, axis].T
        shared = np.where(first == second, _OWN, np.where(abs(first - second) == 1, _BESIDE, 0.0))
        own = posterior / 2 * (_OWN + shared)
        profile = _profile(first, second, posterior, tuning.place_bins, frame, frames)
        for bin_ in (first, second):
            count = profile[bin_] if frame is None else profile[frame, bin_]
            share = (np.maximum(count - own, 0.0) + prior * usual[bin_]) / (others + prior)
            total = total + np.log(share / width[bin_]) / 2
    return total


def _bins(
    ends_mm: Float[np.ndarray, "m 2 3"],
    centre_mm: Float[np.ndarray, "*m 3"],
    axes: Float[np.ndarray, "*m 3 3"],
    tuning: OcclusionTuning,
) -> Int[np.ndarray, "m 2 3"]:
    """The bin of both ends in each coordinate; the outermost hold all beyond."""
    centred = ends_mm - np.expand_dims(centre_mm, -2)
    place = np.einsum("mej,...ij->mei" if axes.ndim == 2 else "mej,mij->mei", centred, axes)
    share = (place / tuning.place_reach + 1) / 2
    return np.clip(np.floor(share * tuning.place_bins), 0, tuning.place_bins - 1).astype(np.int64)


def _empty_profile(
    tuning: OcclusionTuning,
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """(width of each bin, share of each before any line is known: a box, and a few beyond)."""
    bins, reach = tuning.place_bins, tuning.place_reach
    edges, half = np.linspace(-reach, reach, bins + 1), np.sqrt(3.0)
    inside = np.maximum(np.minimum(edges[1:], half) - np.maximum(edges[:-1], -half), 0.0)
    usual = (1 - tuning.place_anywhere) * inside / inside.sum() + tuning.place_anywhere / bins
    width = np.full(bins, 2 * reach / bins)
    width[[0, -1]] *= tuning.place_beyond
    return width, usual


def _profile(
    first: Int[np.ndarray, "m"],
    second: Int[np.ndarray, "m"],
    posterior: Float[np.ndarray, "m"],
    bins: int,
    frame: Int[np.ndarray, "m"] | None,
    frames: int,
) -> Float[np.ndarray, "*f k"]:
    """How many lines there are in each bin, both ends of a line half each, smoothed."""
    start = 0 if frame is None else frame * bins
    # A border of one bin on either side takes what smoothing carries out.
    each = [np.bincount(start + bin_, posterior / 2, frames * bins) for bin_ in (first, second)]
    count = np.pad((each[0] + each[1]).reshape(frames, bins), ((0, 0), (1, 1)))
    smooth = _OWN * count[:, 1:-1] + _BESIDE * (count[:, :-2] + count[:, 2:])
    return smooth[0] if frame is None else smooth
