"""From matches to shadows."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from scipy.special import expit

from trinoc.errors import InputError
from trinoc.geometry import Rig, Segments
from trinoc.match.bodies.casting import (
    casting_pairs,
    evidence_of_surroundings,
    levels_beside,
    planes_of,
)
from trinoc.match.bodies.lamp import Lamp, Votes, best_lamp
from trinoc.match.bodies.shadows import Shadows
from trinoc.match.line_map import join_collinear, snap_corners
from trinoc.match.tracks import Matches
from trinoc.match.tuning import DEFAULT, MatchTuning, ShadowTuning
from trinoc.numerics import ArrayLike, in_float64


@in_float64
def find_shadows(
    matches: Matches,
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    *,
    tuning: MatchTuning = DEFAULT,
) -> Shadows:
    """How likely each track is the boundary of a cast shadow, and where the lamp is.

    A shadow's boundary lies in the plane through the lamp and the edge that casts it, beyond that
    edge. Each line that may be a shadow of another votes for the lamps that would cast it there;
    the levels beside lines, and corners of bodies, say before which lines may. The lamp is a point,
    near or infinitely far, from 12 to 84 degrees above the plane that most lines lie in. Where no
    lamp stands out (`lamp_posterior`), as in soft light, probabilities are low, since little is
    known, not because there are no shadows. No lamp is looked for among more than 150 lines, of
    which some agree on one by chance. Nothing is dropped from the matches.

    Parameters
    ----------
    matches : of `segments` and `rig`.
    segments : for each view those that were matched, as `match_segments` took them. Without
        `side_levels` the levels say nothing.
    rig : the cameras.

    Raises InputError where a view has no segments, and where the covariance of the fragments is
    not known.
    """
    missing = [name for name in matches.views if name not in segments]
    if missing:
        raise InputError(
            f'Shadows need the segments of every view, but "{missing[0]}" has none: give what '
            f"was matched of {', '.join(matches.views)}."
        )
    own = tuning.shadows
    none = np.zeros(3)
    if len(matches) == 0:
        return Shadows(np.zeros(0), 0.0, none, none, 0.0, np.zeros((3, 3)), {"planes": 0})
    joined = join_collinear(matches, rig, tuning=tuning)
    if len(joined) > own.most_lines:
        unknown = np.full(len(matches), own.share_unknown)
        return Shadows(unknown, 0.0, none, none, 0.0, np.zeros((3, 3)), {"lines": len(joined)})
    lines, covariance = joined.lines_mm, joined.covariance_mm2
    middle = lines.mean(axis=(0, 1))
    size = float(np.median(np.linalg.norm(lines - middle, axis=2)))
    cameras = np.mean([np.asarray(rig[name].centre_world_mm) for name in matches.views], axis=0)
    planes = planes_of(lines, covariance, cameras, own)
    levels = levels_beside(matches, segments, joined)
    corners = snap_corners(joined, tuning=tuning)
    known = evidence_of_surroundings(joined, corners, planes, levels, own)
    prior = expit(_log_odds(known, own.first_log_odds))
    without = expit(_log_odds(known, own.log_odds_without))
    counts = {"lines": len(joined), "planes": len(planes), "pairs that a lamp may join": 0}
    if not planes:
        shadow = without[joined.line_of_track]
        return Shadows(shadow, 0.0, middle, none, 0.0, np.zeros((3, 3)), counts)
    pairs = casting_pairs(lines, covariance, middle, size, own)
    counts["pairs that a lamp may join"] = len(pairs.shadow)
    upward = max(planes, key=lambda plane: int(plane.members.sum())).normal
    weight = ((1 - prior) * joined.posterior)[pairs.edge]
    lamp = best_lamp(Votes(pairs, prior, weight, size), upward, own)
    right = _lamp_posterior(lamp, own)
    cast = np.log((1 - own.unexplained) * lamp.ratios + own.unexplained)
    with_lamp = expit(_log_odds(np.column_stack([known, cast]), own.log_odds_with))
    shadow = right * with_lamp + (1 - right) * without
    counts["tracks likely to be shadows"] = int((shadow[joined.line_of_track] > 0.5).sum())
    return Shadows(
        shadow[joined.line_of_track],
        right,
        middle,
        lamp.direction,
        lamp.nearness,
        lamp.covariance,
        counts,
    )


def _log_odds(known: Float[np.ndarray, "e k"], weights: tuple[float, ...]) -> np.ndarray:
    return weights[0] + known @ np.array(weights[1:])


def _lamp_posterior(lamp: Lamp, tuning: ShadowTuning) -> float:
    lead = np.array([[lamp.score, lamp.score - lamp.rival]])
    return float(expit(_log_odds(lead, tuning.log_odds_of_lamp)[0]))
