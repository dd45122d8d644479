"""Whether outlines are those of one cylinder, or of other things that lie so by chance.

A cylinder anywhere in the scene, of any direction, radius and length, gives its outlines a
likelihood, which is integrated over its five parameters about the best ones (Laplace). Against it
stand as many segments anywhere in their pictures, as dense as others of their direction are, and
the tracks that say that some of them are fixed lines in space. Of the pieces of one outline the
longest counts alone: lines of all kinds are broken.
"""

import numpy as np
from jaxtyping import Float

from trinoc.match.cylinders.fit import ROUND, STRAIGHT, Fits, Members, fit_cylinders
from trinoc.match.cylinders.outlines import Outlines, abreast_mm
from trinoc.match.cylinders.support import outlines_shown, same_outline
from trinoc.match.tracks import Matches
from trinoc.match.tuning import CylinderTuning


def log_odds(
    table: Outlines, fits: Fits, members: Members, matches: Matches, tuning: CylinderTuning
) -> Float[np.ndarray, "h"]:
    """That each is a cylinder, against all else."""
    found = _against_chance(table, fits, members, tuning)
    shown = outlines_shown(table, members, len(matches.views)).sum(axis=(1, 2))
    found += shown * np.log(tuning.shown_share)
    found += (2 * len(matches.views) - shown) * np.log(1 - tuning.shown_share)
    return np.log(tuning.prior_cylinders) + found - _as_lines(table, members, matches, tuning)


def _against_chance(
    table: Outlines, fits: Fits, members: Members, tuning: CylinderTuning
) -> Float[np.ndarray, "h"]:
    """Log likelihood ratio to segments anywhere, of one cylinder, or one line, anywhere."""
    longest = ~same_outline(table, members).any(axis=2) & members.held
    primary = Members(np.where(longest, members.row, -1), members.side)
    parameters = fits.information.shape[1]
    best = fit_cylinders(table, primary, *fits[:3], tuning, parameters)
    own = table.take(np.maximum(members.row, 0))
    along = abreast_mm(own.rays, fits.point_mm[:, None], fits.direction[:, None])
    reach = along.max(axis=2) - along.min(axis=2)
    # What a picture as wide as those here would show of the place of the cylinder.
    scene = (own.size_px * reach / own.length_px * members.held).sum(1) / members.held.sum(1)
    # Per pixel and radian, of a segment's middle and direction, is this per pixel of each end.
    common, direction = _common_direction(table, fits, members, tuning)
    by_chance = (np.log((own.density + common) / own.length_px) * longest).sum(axis=1)
    spread = 0.5 * (parameters * np.log(2 * np.pi) - np.linalg.slogdet(best.information)[1])
    # Any place across the axis; any radius below half the scene.
    anywhere = np.log(direction) - 2 * np.log(scene)
    if parameters == ROUND:
        anywhere -= np.log(scene / 2)
    # Where along the axis: outlines lie on one part of it, other segments anywhere.
    extent = np.where(members.held, along.max(axis=2), -np.inf).max(axis=1)
    extent -= np.where(members.held, along.min(axis=2), np.inf).min(axis=1)
    share = own.length_px / reach * extent[:, None] / own.size_px
    abreast = 2 * np.log(np.minimum(extent / scene, 1.0)) - (np.log(share) * longest).sum(axis=1)
    return best.log_likelihood + spread + anywhere + abreast - by_chance


def _common_direction(
    table: Outlines, fits: Fits, members: Members, tuning: CylinderTuning
) -> tuple[Float[np.ndarray, "h k"], Float[np.ndarray, "h"]]:
    """What is as parallel to each axis as to tell nothing: segments of each outline's view, per
    pixel and radian; and the density of axes, per steradian, half of them along such segments."""
    width = np.radians(tuning.common_deg)
    along = np.abs(fits.direction @ table.normals.T) < np.sin(width)
    row, column = np.nonzero(members.held)
    along[row, members.row[row, column]] = False
    same = table.view == np.arange(int(table.view.max(initial=0)) + 1)[:, None]
    number = along.astype(np.float64) @ same.T
    own = np.maximum(members.row, 0)
    common = np.take_along_axis(number, table.view[own], axis=1)
    common = common / (table.size_px[own] * 2 * width)
    chance = 2 * width / np.pi
    share = np.maximum(along.sum(axis=1) / max(len(table.view), 1) - chance, 0.0)
    return common, 0.5 / (2 * np.pi) + 0.5 * share / (2 * np.pi * (1 - np.cos(width)))


def _as_lines(
    table: Outlines, members: Members, matches: Matches, tuning: CylinderTuning
) -> Float[np.ndarray, "h"]:
    """Log odds of the tracks that a cylinder would undo: they hold an outline of it."""
    gain = np.maximum(_of_tracks(table, matches, tuning), 0.0)
    undone = np.zeros((len(members.row), len(matches)), dtype=bool)
    for k in range(members.row.shape[1]):
        rows = np.flatnonzero(members.held[:, k])
        outline = members.row[rows, k]
        own = matches.index[:, table.view[outline]] == table.segment[outline]
        undone[rows] |= own.T
    return undone @ gain


def _of_tracks(table: Outlines, matches: Matches, tuning: CylinderTuning) -> Float[np.ndarray, "t"]:
    """That each track is a line in space: what the matcher says, or what its segments say here."""
    posterior = np.clip(np.asarray(matches.posterior), 1e-9, 1 - 1e-9)
    gain = np.log(posterior) - np.log1p(-posterior)
    row = np.full(matches.index.shape, -1)
    for view in range(len(matches.views)):
        here = np.flatnonzero(table.view == view)
        number = np.full(int(matches.index[:, view].max(initial=-1)) + 2, -1)
        inside = table.segment[here] < len(number) - 1
        number[table.segment[here[inside]]] = here[inside]
        row[:, view] = number[matches.index[:, view]]
    seen = matches.index >= 0
    known = np.flatnonzero((seen == (row >= 0)).all(axis=1))
    if len(known) == 0:
        return gain
    lines = matches.lines_mm[known]
    way = lines[:, 1] - lines[:, 0]
    way = way / np.linalg.norm(way, axis=1, keepdims=True)
    own = Members(row[known], np.where(seen[known], 1.0, 0.0))
    start = lines.mean(axis=1), way, np.zeros(len(known))
    straight = fit_cylinders(table, own, *start, tuning, STRAIGHT)
    found = np.log(tuning.prior_lines) + _against_chance(table, straight, own, tuning)
    gain[known] = np.maximum(gain[known], found)
    return gain
