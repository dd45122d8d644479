"""Which tracks are boundaries of cast shadows, and the lamp: from matches to shadows."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.special import expit

from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.bodies.casting import (
    casting_pairs,
    evidence_of_surroundings,
    side_levels_of_lines,
    suggest_planes,
)
from trinoc.match.bodies.lamp import Votes, best_lamp
from trinoc.match.line_map.collinear_merge import join_collinear
from trinoc.match.line_map.corners import snap_corners
from trinoc.match.observations.pictures_of_views import segments_of_views
from trinoc.match.tracks.matches import EVEN, Matches
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.numerics.precision import ArrayLike, in_float64


class Shadows(eqx.Module):
    """Probabilities of tracks, and the lamp that they rest on.

    Fields
    ------
    shadow : (t,) probability that each track of the matches is the boundary of a cast shadow.
    lamp_posterior : probability that the lamp below is the true one; 0 where there is none to tell.
    middle_mm : (3,) middle of the scene, from which the lamp is seen.
    toward_lamp : (3,) unit vector from there, in the world frame; zeros where nothing is known.
    nearness_per_mm : 1 over the distance of the lamp; 0 where its light is parallel.
    lamp_covariance : (3, 3) of the turn of `toward_lamp` about its two axes across
        (`complete_axes`), rad, and of `nearness_per_mm`.
    counts : what each step produced, by name.
    """

    shadow: Float[np.ndarray, "t"]
    lamp_posterior: float
    middle_mm: Float[np.ndarray, "3"]
    toward_lamp: Float[np.ndarray, "3"]
    nearness_per_mm: float
    lamp_covariance: Float[np.ndarray, "3 3"]
    counts: dict[str, int]

    @property
    def lamp_known(self) -> bool:
        """Whether the lamp found is likelier the true one than not."""
        return self.lamp_posterior > EVEN

    @property
    def lamp_sigma_deg(self) -> float:
        """Standard deviation of the lamp's direction, the larger one."""
        return float(np.degrees(np.sqrt(np.linalg.eigvalsh(self.lamp_covariance[:2, :2])[-1])))

    @property
    def lamp_mm(self) -> Float[np.ndarray, "4"]:
        """The lamp's place in homogeneous coordinates: infinitely far where the last is 0."""
        place = self.toward_lamp + self.nearness_per_mm * self.middle_mm
        return np.append(place, self.nearness_per_mm)

    def mark(self, matches: Matches) -> Matches:
        """The matches that the shadows were found in, with the mark "shadow"."""
        return matches.with_marks(shadow=self.shadow)

    def summary(self) -> str:
        """How many tracks are likely shadows, and where the lamp is."""
        marked = int((self.shadow > EVEN).sum())
        said = (
            "1 track is likely a shadow" if marked == 1 else f"{marked} tracks are likely shadows"
        )
        if not self.lamp_known:
            return f"{said}; no lamp stands out, so little is known of shadows."
        x, y, z = self.toward_lamp
        return (
            f"{said}; the lamp is toward ({x:.3f}, {y:.3f}, {z:.3f}) +- "
            f"{self.lamp_sigma_deg:.2f} degrees, posterior {self.lamp_posterior:.3f}."
        )

    def record(self) -> dict[str, Any]:
        """The same and the lamp's covariance, as JSON holds them."""
        return {
            "tracks_marked": int((self.shadow > EVEN).sum()),
            "lamp_posterior": self.lamp_posterior,
            "middle_mm": self.middle_mm.tolist(),
            "toward_lamp": self.toward_lamp.tolist(),
            "nearness_per_mm": self.nearness_per_mm,
            "lamp_covariance": self.lamp_covariance.tolist(),
            "counts": self.counts,
        }


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
    near or infinitely far, from 10 to 80 degrees above the plane that most lines lie in. Where no
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
    given = segments_of_views("Finding shadows", matches.views, segments)
    own = tuning.shadows
    none = np.zeros(3)
    if len(matches) == 0:
        return Shadows(np.zeros(0), 0.0, none, none, 0.0, np.zeros((3, 3)), {"planes": 0})
    joined = join_collinear(matches, rig, tuning=tuning)
    if len(joined) > own.most_lines:
        unknown = np.full(len(matches), expit(own.log_odds_without))
        return Shadows(unknown, 0.0, none, none, 0.0, np.zeros((3, 3)), {"lines": len(joined)})
    lines, covariance = joined.lines_mm, joined.covariance_mm2
    middle = lines.mean(axis=(0, 1))
    size = float(np.median(np.linalg.norm(lines - middle, axis=2)))
    cameras = np.mean([np.asarray(rig[name].centre_world_mm) for name in matches.views], axis=0)
    planes = suggest_planes(lines, covariance, cameras, own)
    levels = side_levels_of_lines(matches, given, joined)
    corners = snap_corners(joined, tuning=tuning)
    known = evidence_of_surroundings(joined, corners, planes, levels, own)
    odds = own.log_odds[0] + known @ np.array(own.log_odds[1:])
    prior, without = expit(odds), np.full(len(joined), expit(own.log_odds_without))
    counts = {"lines": len(joined), "planes": len(planes), "pairs that a lamp may join": 0}
    if not planes:
        shadow = without[joined.line_of_track]
        return Shadows(shadow, 0.0, middle, none, 0.0, np.zeros((3, 3)), counts)
    pairs = casting_pairs(lines, covariance, middle, own)
    counts["pairs that a lamp may join"] = len(pairs.shadow)
    upward = max(planes, key=lambda plane: int(plane.members.sum())).normal
    weight = ((1 - prior) * joined.posterior)[pairs.edge]
    lamp = best_lamp(Votes(pairs, prior, weight, size), upward, own)
    first, by_score = own.log_odds_of_lamp
    right = float(expit(first + by_score * lamp.score))
    cast = np.log((1 - own.unexplained) * lamp.ratios + own.unexplained)
    with_lamp = expit(odds + cast)
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
