"""The matcher's answer: tracks of segments over the views, and their lines in space."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.errors import InputError
from trinoc.geometry import LineObservations
from trinoc.numerics import Displayable

TRINOCULAR, BINOCULAR = "trinocular", "binocular"


class Matches(Displayable, eqx.Module):
    """Tracks: each joins one segment of every view that sees it, and holds the 3-D segment.

    Fields
    ------
    views : names of the views, the order of axis v.
    index : (t, v) segment of each view on each track, -1 where not seen. One segment may
        serve several tracks, with different fragments.
    fragments_px : (t, v, 2, 2) the common parts, corresponding end to corresponding end, in
        pixels of the picture; NaN where not seen.
    lines_mm : (t, 2, 3) ends, in the world frame, of what at least two views show: the
        fragments' part or more, in the fragments' direction.
    covariance_mm2 : (t, 6, 6) of the ends.
    stage : (t,) "trinocular" (seen in three or more views) or "binocular" (in two).
    posterior : (t,) probability that the match is right.
    rival_posterior : (t,) posterior of the best candidate that this one excluded; 0 where none.
    reasons : for each view, (n,) words that say why a segment is on no track, "matched"
        where it is on one.
    counts : what each step of the matching produced and rejected, by name.
    fragments_covariance_px2 : (t, v, 4, 4) of the fragments' ends, NaN where not seen; None
        where not known.
    misfit : (t,) chi-square by which the views disagree about where a line is, with 2 (n - 2)
        degrees of freedom for n views that see it; 0 for two views. None where not known.
    viewpoint_dependent : (t,) whether a track is likely to show something that depends on
        the viewpoint: the outline of a round body, or a highlight. In three views its misfit is
        larger than that of 99 in 100 straight edges. In two, another view shows a segment beside
        the place where the line should be, and none on it. None where not known.
    guided : (t, v) whether a fragment's segment was added, or made longer, by guided detection
        (`guide_matches`); None where that has not been asked for.
    measure : (t, v) "pixels" where a view's place rests on its grey levels (`measure_lines`), else
        why its segment's place is kept: "too short", "neighbours" (other edges are too near), "too
        faint", "no clean step", "another edge", or "disagrees" (the line's pixels and its segments
        do, and so do its views); "" where not seen. None where that has not been asked for.
    silhouette : (t,) probability that a track holds an outline of a cylinder, and so is no line in
        space (`find_cylinders`); None where that has not been asked for.
    shadow : (t,) probability that a track is the boundary of a cast shadow, and so no edge of a
        body (`find_shadows`); None where that has not been asked for.
    noise_scale : standard deviation of the segments across themselves over what they state, as
        three views show it: all covariances here are of the errors found. 1 where two views are
        all there is.
    noise_tail : how unequal the tracks' errors are, as three views show it: one over the degrees of
        freedom of their Student distribution, 0 where they are normal. The 95 % ellipsoids of
        `covariance_mm2` hold in 95 % of cases, each with the misfit of its own track in mind.
    notes : sentences on what a user should know of the whole: noise far from what is stated,
        cameras in one line.
    """

    views: tuple[str, ...] = eqx.field(static=True)
    index: Int[np.ndarray, "t v"]
    fragments_px: Float[np.ndarray, "t v 2 2"]
    lines_mm: Float[np.ndarray, "t 2 3"]
    covariance_mm2: Float[np.ndarray, "t 6 6"]
    stage: Shaped[np.ndarray, "t"]
    posterior: Float[np.ndarray, "t"]
    rival_posterior: Float[np.ndarray, "t"]
    reasons: dict[str, Shaped[np.ndarray, "_"]]
    counts: dict[str, int]
    fragments_covariance_px2: Float[np.ndarray, "t v 4 4"] | None = None
    misfit: Float[np.ndarray, "t"] | None = None
    viewpoint_dependent: Bool[np.ndarray, "t"] | None = None
    noise_scale: float = eqx.field(static=True, default=1.0)
    notes: tuple[str, ...] = eqx.field(static=True, default=())
    guided: Bool[np.ndarray, "t v"] | None = None
    measure: Shaped[np.ndarray, "t v"] | None = None
    silhouette: Float[np.ndarray, "t"] | None = None
    noise_tail: float = eqx.field(static=True, default=0.0)
    shadow: Float[np.ndarray, "t"] | None = None

    def __len__(self) -> int:
        return len(self.index)

    def line_observations(self) -> LineObservations:
        """The tracks as observations of lines, which joint refinement takes.

        Raises InputError where the covariance of the fragments is not known.
        """
        if self.fragments_covariance_px2 is None:
            raise InputError(
                "These matches do not hold the covariance of their fragments, which refinement "
                "needs: match the segments again with this version."
            )
        return LineObservations(
            self.views,
            self.fragments_px,
            self.fragments_covariance_px2,
            self.index >= 0,
            self.lines_mm,
        )
