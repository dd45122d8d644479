"""Every segment that touches a cylinder within errors, in all views: its outlines."""

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.bodies.cylinder_fit import ROUND, STRAIGHT, Fits, Members, fit_cylinders
from trinoc.match.bodies.cylinder_hypotheses import Start
from trinoc.match.bodies.outlines import Outlines, abreast_mm, before_camera, ray_axis_distances
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.every_group import MatchTuning
from trinoc.numerics.buckets import blocks
from trinoc.numerics.tables import concatenate_rows, take_rows
from trinoc.numerics.tails import chi_square_limit

# numerical: cylinders that are compared with all outlines at once.
AT_ONCE = 1024
# numerical: outlines that say more than five parameters take.
FEWEST = 4
# numerical: rounds in which outlines are added, which converge.
ROUNDS = 3
# numerical: a margin for time: outlines further off than this share of the radius do not touch.
_ABOUT_RADIUS = 0.5


def with_support(table: Outlines, start: Start, tuning: MatchTuning) -> tuple[Fits, Members]:
    """Cylinders that fit their three outlines, each with every outline that fits it.

    Rounds, since more outlines leave a better cylinder. Cylinders of the same outlines are one.
    """
    fits = fit_cylinders(table, *start, tuning)
    good = _are_determined(fits, tuning)
    good &= fits.square < chi_square_limit(tuning.collinear.significance, fits.degrees)
    fits, members = take_rows((fits, start.members), good)
    for _ in range(ROUNDS):
        members = _single(table, fits, _touching(table, fits, members, tuning), tuning)
        fits, members = take_rows((fits, members), _distinct(table, members))
        fits = fit_cylinders(table, members, *fits[:3], tuning)
        fits, members = take_rows((fits, members), _are_determined(fits, tuning))
    return fits, members


def _are_determined(fits: Fits, tuning: MatchTuning) -> Bool[np.ndarray, "h"]:
    """Cylinders that their outlines determine: a linear error holds for axis and radius."""
    determined = np.isfinite(fits.square) & (fits.degrees > 0)
    variance = np.einsum("hii->hi", fits.covariance)
    size = np.stack([*[fits.radius_mm] * 2, *[np.ones_like(fits.radius_mm)] * 2, fits.radius_mm])
    return determined & (variance < (tuning.cylinders.largest_doubt * size.T) ** 2).all(axis=1)


def _touching(table: Outlines, fits: Fits, members: Members, tuning: MatchTuning) -> Members:
    """The outlines of each cylinder: those whose ends lie where they must, within errors."""
    low, high = _extent(table, fits, members)
    known = fits.covariance
    limit = chi_square_limit(tuning.collinear.significance, 2)
    parts = []
    for part in blocks(len(fits.radius_mm), AT_ONCE):
        here, row = _roughly_touching(table, fits, part, tuning)
        owner = here + part.start
        rays = take_rows(table.rays, row)
        point, direction = fits.point_mm[owner], fits.direction[owner]
        beside = ray_axis_distances(rays, point, direction)
        own = np.sign(beside.distance_mm.mean(axis=1))
        residual = own[:, None] * fits.radius_mm[owner, None] - beside.distance_mm
        residual = residual / beside.per_px
        turned = -np.broadcast_to(own[:, None, None], (*residual.shape, 1))
        jacobian = np.concatenate([beside.by_axis, turned], axis=-1) / beside.per_px[..., None]
        spread = jacobian @ known[owner] @ jacobian.mT + table.across_px2[row]
        square = np.einsum("me,mef,mf->m", residual, np.linalg.inv(spread), residual)
        along = np.sort(abreast_mm(rays, point, direction), axis=1)
        common = np.minimum(along[:, 1], high[owner]) - np.maximum(along[:, 0], low[owner])
        good = (square < limit) & before_camera(rays, point)
        good &= common > tuning.tracks.abreast_share * (along[:, 1] - along[:, 0])
        # A ray through the axis itself passes it on neither side.
        good &= own != 0
        parts.append((owner[good], row[good], own[good]))
    return _gather_members(len(fits.radius_mm), *concatenate_rows(parts))


def _roughly_touching(
    table: Outlines, fits: Fits, part: slice, tuning: MatchTuning
) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"]]:
    """(cylinder, outline) where the outline's plane is along the axis and about a radius off."""
    normal = table.normals
    offset = (normal * table.rays.centre_mm).sum(axis=1)
    turn = np.abs(fits.direction[part] @ normal.T)
    radius = fits.radius_mm[part, None]
    gap = np.abs(np.abs(fits.point_mm[part] @ normal.T - offset) - radius)
    near = turn < np.sin(np.radians(tuning.cylinders.parallel_deg))
    here, row = np.nonzero(near & (gap < _ABOUT_RADIUS * radius))
    return here, row


def _extent(
    table: Outlines, fits: Fits, members: Members
) -> tuple[Float[np.ndarray, "h"], Float[np.ndarray, "h"]]:
    """From where to where along its axis the outlines of each cylinder reach."""
    own = members.rows_of(table)
    along = abreast_mm(own.rays, fits.point_mm[:, None], fits.direction[:, None])
    low = np.where(members.held, along.min(axis=2), np.inf).min(axis=1)
    high = np.where(members.held, along.max(axis=2), -np.inf).max(axis=1)
    return low, high


def _gather_members(
    count: int,
    owner: Int[np.ndarray, "m"],
    row: Int[np.ndarray, "m"],
    side: Float[np.ndarray, "m"],
) -> Members:
    """The outlines of `count` cylinders side by side; they come in the order of their owners."""
    column = np.arange(len(owner)) - np.searchsorted(owner, owner)
    # A column of none where there are no outlines at all.
    shape = count, int(column.max(initial=0)) + 1
    members = Members(np.full(shape, -1), np.zeros(shape))
    members.row[owner, column], members.side[owner, column] = row, side
    return members


def _single(table: Outlines, fits: Fits, members: Members, tuning: MatchTuning) -> Members:
    """Without those mostly abreast of a longer one that lies on the same side in its view."""
    own = members.rows_of(table)
    along = abreast_mm(own.rays, fits.point_mm[:, None], fits.direction[:, None])
    low, high = along.min(axis=2), along.max(axis=2)
    common = np.minimum(high[:, :, None], high[:, None]) - np.maximum(low[:, :, None], low[:, None])
    abreast = common > tuning.tracks.abreast_share * (high - low)[:, :, None]
    doubled = (abreast & same_outline(table, members)).any(axis=2)
    owner, column = np.nonzero(members.held & ~doubled)
    own = members.row[owner, column], members.side[owner, column]
    return _gather_members(len(doubled), owner, *own)


def same_outline(table: Outlines, members: Members) -> Bool[np.ndarray, "h k k"]:
    """Whether a longer one of the same view and side, which stands before, is as good as each."""
    outline = assign_outlines(table, members)
    same = (outline[:, :, None] == outline[:, None]) & members.held[:, :, None]
    return same & np.tri(members.row.shape[1], k=-1, dtype=bool)


def _distinct(table: Outlines, members: Members) -> Int[np.ndarray, "k"]:
    """The cylinders of each set of outlines once, where it is enough."""
    _, kept = np.unique(members.row, axis=0, return_index=True)
    views = int(table.view.max(initial=0)) + 1
    shown = outlines_shown(table, take_rows(members, kept), views)
    return kept[(shown.sum(axis=(1, 2)) >= FEWEST) & (shown.any(axis=2).sum(axis=1) > 1)]


def outlines_shown(table: Outlines, members: Members, views: int) -> Bool[np.ndarray, "h v 2"]:
    """Which of the two outlines of each view have a segment."""
    shown = np.zeros((len(members.row), 2 * views), dtype=bool)
    outline = assign_outlines(table, members)
    owner, column = np.nonzero(members.held)
    shown[owner, outline[owner, column]] = True
    return shown.reshape(-1, views, 2)


def assign_outlines(table: Outlines, members: Members) -> Int[np.ndarray, "h k"]:
    """Which of the two outlines of all views each is a piece of; -1 beyond the last."""
    outline = 2 * table.view[np.maximum(members.row, 0)] + (members.side > 0)
    return np.where(members.held, outline, -1)


def support_log_odds(
    table: Outlines, fits: Fits, members: Members, matches: Matches, tuning: MatchTuning
) -> Float[np.ndarray, "h"]:
    """That each is a cylinder, against all else."""
    found = _against_chance(table, fits, members, tuning)
    shown = outlines_shown(table, members, len(matches.views)).sum(axis=(1, 2))
    found += shown * np.log(tuning.cylinders.shown_share)
    found += (2 * len(matches.views) - shown) * np.log(1 - tuning.cylinders.shown_share)
    return found - _as_lines(table, members, matches, tuning)


def _against_chance(
    table: Outlines, fits: Fits, members: Members, tuning: MatchTuning
) -> Float[np.ndarray, "h"]:
    """Log likelihood ratio to segments anywhere, of one cylinder, or one line, anywhere."""
    longest = ~same_outline(table, members).any(axis=2) & members.held
    primary = Members(np.where(longest, members.row, -1), members.side)
    parameters = fits.information.shape[1]
    best = fit_cylinders(table, primary, *fits[:3], tuning, parameters)
    own = members.rows_of(table)
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
    table: Outlines, fits: Fits, members: Members, tuning: MatchTuning
) -> tuple[Float[np.ndarray, "h k"], Float[np.ndarray, "h"]]:
    """What is as parallel to each axis as to tell nothing: segments of each outline's view, per
    pixel and radian; and the density of axes, per steradian, half of them along such segments."""
    width = np.radians(tuning.cylinders.common_deg)
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
    table: Outlines, members: Members, matches: Matches, tuning: MatchTuning
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


def _of_tracks(table: Outlines, matches: Matches, tuning: MatchTuning) -> Float[np.ndarray, "t"]:
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
    found = np.log(tuning.cylinders.prior_lines) + _against_chance(table, straight, own, tuning)
    gain[known] = np.maximum(gain[known], found)
    return gain
