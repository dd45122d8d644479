"""The matcher's answer: tracks of segments over the views, and their lines in space."""

import enum
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import Annotated, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.errors import InputError
from trinoc.geometry.features import Wires
from trinoc.geometry.line_lengths import line_sigmas
from trinoc.geometry.rig import is_camera_name
from trinoc.geometry.segments import LineObservations
from trinoc.match.tracks.unequal_errors import degrees_of_misfit, ellipsoid_limit
from trinoc.match.tuning.tracks import DecoyTuning
from trinoc.numerics.display import Displayable
from trinoc.numerics.tables import (
    CHI_SQUARE,
    COVARIANCE,
    IN_SCENE,
    LARGEST_PX,
    PROBABILITY,
    Column,
    ColumnCheck,
    Content,
    Table,
    is_covariance,
)

TRINOCULAR, BINOCULAR = "trinocular", "binocular"
# The count, 1 or none, of a set of segments that does not seem to belong to its rig.
SUSPECT_SETS = "suspect sets"
# numerical: a mark that is likelier true than not.
EVEN = 0.5

_ENDS = ("x1_mm", "y1_mm", "z1_mm", "x2_mm", "y2_mm", "z2_mm")
# numerical: what rounding leaves of a share.
_ROUNDING = 1e-9


def _is_seen(table: Content) -> np.ndarray:
    return table.values["index"] >= 0


def _segments_of_views(table: Content) -> list[int]:
    reasons = table.values["reasons"]
    return [len(reasons.get(view, ())) for view in table.values["views"]]


def _are_covariances_where_seen(covariance: np.ndarray, table: Content) -> np.ndarray:
    good = np.ones(covariance.shape[:2], dtype=bool)
    good[_is_seen(table)] = is_covariance(covariance[_is_seen(table)])
    return good


def _are_probabilities_where_seen(posterior: np.ndarray, table: Content) -> np.ndarray:
    inside = (posterior >= 0) & (posterior <= 1 + _ROUNDING)
    return np.where(_is_seen(table), inside, np.isnan(posterior))


def _are_marks(marks: Mapping[str, np.ndarray], table: Content) -> bool:
    """Truth values, probabilities or words of tracks, or of what each view sees of them."""
    seen = _is_seen(table)
    for mark in marks.values():
        if mark.shape not in (seen.shape, seen.shape[:1]) or mark.dtype.kind not in "bfU":
            return False
        if mark.dtype.kind == "f" and not ((mark >= 0) & (mark <= 1 + _ROUNDING)).all():
            return False
        if mark.shape == seen.shape and mark[~seen].astype(bool).any():
            return False
    return True


class MatchStatus(enum.Enum):
    """Whether the matches can be used; the value is the sentence shown to people.

    SUSPECT where segments and rig do not seem to belong together; UNCERTAIN where nothing is
    against them, but too few lines are sure, their errors are far above those stated, or they are
    large against the scene. `assess_matches` has the reason and the remedy.
    """

    MATCHED = "You can use these matches."
    UNCERTAIN = "Use these matches with care."
    SUSPECT = "Do not rely on these matches."


class Matches(Displayable, Table):
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
        where it is on one, "matched within a pattern" where a partner one period off fits as well.
    counts : what each step of the matching produced and rejected, by name.
    fragments_covariance_px2 : (t, v, 4, 4) of the fragments' ends, NaN where not seen; None
        where not known.
    misfit : (t,) chi-square by which the views disagree about where a line is, with 2 (n - 2)
        degrees of freedom for n views that see it; 0 for two views. None where not known.
    viewpoint_dependent : (t,) whether a track is likely to show something that depends on
        the viewpoint: the outline of a round body, or a highlight. In three views its misfit is
        larger than that of 99 in 100 straight edges. In two, another view shows a segment beside
        the place where the line should be, and none on it. None where not known.
    member_posterior : (t, v) probability that the segment of each view is of the line that the
        track's other segments show; NaN where not seen. Of a track in two or three views it is the
        track's posterior, as too few others are left. None where not known.
    rig_covariance_mm2 : (t, 6, 6) what errors of the rig's parameters add to `covariance_mm2` of
        each track (`with_rig_covariance`). These errors are common to all tracks: they move and
        turn the scene as a whole. None where not known.
    marks : what later steps say of tracks, (t,) or (t, v), by name: truth values, probabilities or
        words; False, 0 or "" where a view sees no line. Each step names its own: "measure"
        (`measure_lines`), "silhouette" (`find_rims`).
    noise_scale : standard deviation of the segments across themselves over what they state, as
        three views show it: all covariances here are of the errors found. 1 where two views are
        all there is.
    noise_tail : how unequal the tracks' errors are, as three views show it: one over the degrees of
        freedom of their Student distribution, 0 where they are normal. The 95 % ellipsoids of
        `covariance_mm2` hold in 95 % of cases, each with the misfit of its own track in mind;
        `ellipsoid_limit` has others.
    notes : sentences on what a user should know of the whole: noise far from what is stated,
        cameras in one line.
    """

    KIND: ClassVar[str] = "matches"
    IN_WORDS: ClassVar[str] = "matches"
    SIDES: ClassVar[Mapping[str, str]] = {"t": "tracks", "v": "views"}
    DERIVED: ClassVar[Mapping[str, Sequence[str]]] = {
        "length_mm": (),
        "length_sigma_mm": (),
        "across_sigma_mm": (),
    }

    views: Annotated[
        tuple[str, ...],
        Column(
            ColumnCheck(
                "must be two or more different ones",
                lambda views, _: len(set(views)) >= max(len(views), 2),
            ),
            ColumnCheck(
                "must be names of printable characters",
                lambda views, _: all(map(is_camera_name, views)),
            ),
            side="v",
        ),
    ] = eqx.field(static=True)
    index: Annotated[
        Int[np.ndarray, "t v"],
        Column(
            ColumnCheck(
                "names a segment that is not there",
                lambda index, table: (index >= -1) & (index < _segments_of_views(table)),
            ),
            ColumnCheck(
                "names fewer than two segments", lambda index, _: (index >= 0).sum(axis=1) >= 2
            ),
            parts=lambda matches: [f"{view}_segment" for view in matches.views],
        ),
    ]
    fragments_px: Annotated[
        Float[np.ndarray, "t v 2 2"],
        Column(
            ColumnCheck(
                "is no part of a segment where one is seen, or one where none is",
                lambda ends, table: np.where(
                    _is_seen(table)[..., None, None], np.abs(ends) < LARGEST_PX, np.isnan(ends)
                ),
            ),
            parts=lambda matches: [
                f"{view}_{part}_px" for view in matches.views for part in ("u1", "v1", "u2", "v2")
            ],
        ),
    ]
    lines_mm: Annotated[Float[np.ndarray, "t 2 3"], Column(IN_SCENE, parts=_ENDS)]
    covariance_mm2: Annotated[Float[np.ndarray, "t 6 6"], Column(COVARIANCE, parts=_ENDS)]
    stage: Annotated[
        Shaped[np.ndarray, "t"],
        Column(
            ColumnCheck(
                f"is not {TRINOCULAR} or {BINOCULAR} as its views say",
                lambda stage, table: (
                    stage == np.where(_is_seen(table).sum(axis=1) > 2, TRINOCULAR, BINOCULAR)
                ),
            )
        ),
    ]
    posterior: Annotated[Float[np.ndarray, "t"], Column(PROBABILITY)]
    rival_posterior: Annotated[Float[np.ndarray, "t"], Column(PROBABILITY)]
    reasons: Annotated[
        dict[str, Shaped[np.ndarray, "_"]],
        Column(
            ColumnCheck(
                "are not those of the views",
                lambda reasons, table: set(reasons) == set(table.values["views"]),
            )
        ),
    ]
    counts: dict[str, int]
    fragments_covariance_px2: Annotated[
        Float[np.ndarray, "t v 4 4"] | None,
        Column(
            ColumnCheck("is no covariance where a view sees the line", _are_covariances_where_seen)
        ),
    ] = None
    misfit: Annotated[Float[np.ndarray, "t"] | None, Column(CHI_SQUARE)] = None
    viewpoint_dependent: Bool[np.ndarray, "t"] | None = None
    noise_scale: Annotated[
        float, Column(ColumnCheck("is no scale", lambda scale, _: 0 < scale < np.inf))
    ] = eqx.field(static=True, default=1.0)
    notes: tuple[str, ...] = eqx.field(static=True, default=())
    noise_tail: Annotated[
        float, Column(ColumnCheck("is no tail", lambda tail, _: 0 <= tail < np.inf))
    ] = eqx.field(static=True, default=0.0)
    member_posterior: Annotated[
        Float[np.ndarray, "t v"] | None,
        Column(
            ColumnCheck(
                "is no probability where a view sees the line", _are_probabilities_where_seen
            ),
            parts=lambda matches: [f"{view}_posterior" for view in matches.views],
        ),
    ] = None
    rig_covariance_mm2: Annotated[Float[np.ndarray, "t 6 6"] | None, Column(COVARIANCE)] = None
    marks: Annotated[
        dict[str, Shaped[np.ndarray, "..."]],
        Column(
            ColumnCheck("are no truth values, probabilities or words of tracks", _are_marks),
            per_row=True,
        ),
    ] = field(default_factory=dict)

    @property
    def status(self) -> MatchStatus:
        """Whether the matches can be used; of SUSPECT ones the first note says why not."""
        from trinoc.match.tracks.reliability import assess_matches

        return assess_matches(self).status

    @property
    def share_in_three_views(self) -> float:
        """Of the segments of a view: the share on sure tracks of three views or more, in the view
        where that is least. A camera that was knocked has a small one."""
        sure = (self.posterior > DecoyTuning.sure) & (self.stage == TRINOCULAR)
        return min(
            len(np.setdiff1d(of_view, -1)) / max(len(self.reasons[name]), 1)
            for name, of_view in zip(self.views, self.index[sure].T, strict=True)
        )

    @property
    def length_mm(self) -> Float[np.ndarray, "t"]:
        """(t,) length of each segment in space."""
        return line_sigmas(self.lines_mm, self.covariance_mm2).length_mm

    @property
    def length_sigma_mm(self) -> Float[np.ndarray, "t"]:
        """(t,) standard deviation of each length."""
        return line_sigmas(self.lines_mm, self.covariance_mm2).length_sigma_mm

    @property
    def across_sigma_mm(self) -> Float[np.ndarray, "t"]:
        """(t,) standard deviation of each midpoint in the worst direction across the segment."""
        return line_sigmas(self.lines_mm, self.covariance_mm2).across_sigma_mm

    def ellipsoid_limit(self, probability: float) -> Float[np.ndarray, "t"]:
        """(t,) square of the Mahalanobis distance within which a line lies with this probability.

        Distances are those of both ends from the true line, across it, by `covariance_mm2`: of four
        degrees of freedom. At .95 it is that of a normal distribution; errors that are unequal
        (`noise_tail`, of segments) are nearer at lower probabilities, and farther at higher ones.
        Raises InputError for what is no probability between 0 and 1.
        """
        if not 0 < probability < 1:
            raise InputError(f"probability is {probability}: give one between 0 and 1.")
        return ellipsoid_limit(probability, degrees_of_misfit(self.index), self.noise_tail)

    def wires(self) -> Wires:
        """Each segment as a line of its own."""
        pairs = np.arange(2 * len(self)).reshape(-1, 2)
        return Wires(self.lines_mm.reshape(-1, 3), pairs, np.arange(len(self)))

    def with_marks(self, **marks: Shaped[np.ndarray, "..."]) -> "Matches":
        """The same with more that is said of the tracks, or with other values of it."""
        return replace(self, marks=self.marks | marks)

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
