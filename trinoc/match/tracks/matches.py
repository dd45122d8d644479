"""Result of the matcher: tracks of segments over the views, and their lines in space."""

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
# Name of the count (1 or absent) of a set that does not seem to belong to its rig.
SUSPECT_SETS = "suspect sets"
# numerical: posterior at which right and wrong are equally likely.
EVEN_POSTERIOR = 0.5

_ENDS = ("x1_mm", "y1_mm", "z1_mm", "x2_mm", "y2_mm", "z2_mm")
# numerical: rounding error of a probability.
_ROUNDING = 1e-9


def _is_observed(table: Content) -> np.ndarray:
    return table.values["index"] >= 0


def _segments_of_views(table: Content) -> list[int]:
    reasons = table.values["reasons"]
    return [len(reasons.get(view, ())) for view in table.values["views"]]


def _are_covariances_where_observed(covariance: np.ndarray, table: Content) -> np.ndarray:
    is_valid = np.ones(covariance.shape[:2], dtype=bool)
    is_valid[_is_observed(table)] = is_covariance(covariance[_is_observed(table)])
    return is_valid


def _are_probabilities_where_observed(posterior: np.ndarray, table: Content) -> np.ndarray:
    inside = (posterior >= 0) & (posterior <= 1 + _ROUNDING)
    return np.where(_is_observed(table), inside, np.isnan(posterior))


def _are_marks(marks: Mapping[str, np.ndarray], table: Content) -> bool:
    """True if all marks are booleans, probabilities or strings, with shape (t,) or (t, v)."""
    is_observed = _is_observed(table)
    for mark in marks.values():
        if (
            mark.shape not in (is_observed.shape, is_observed.shape[:1])
            or mark.dtype.kind not in "bfU"
        ):
            return False
        if mark.dtype.kind == "f" and not ((mark >= 0) & (mark <= 1 + _ROUNDING)).all():
            return False
        if mark.shape == is_observed.shape and mark[~is_observed].astype(bool).any():
            return False
    return True


class MatchStatus(enum.Enum):
    """Overall result of the checks on matches; the value is a sentence for users.

    UNCERTAIN: too few lines are sure, the errors are far above the stated ones, or the errors are
    large relative to the scene. SUSPECT: segments and rig do not seem to belong together.
    `assess_matches` returns the reason and the remedy.
    """

    MATCHED = "You can use these matches."
    UNCERTAIN = "Use these matches with care."
    SUSPECT = "Do not rely on these matches."


class Matches(Displayable, Table):
    """Tracks with their lines in space. A track joins the segments of all views that show one line.

    Attributes
    ----------
    views : tuple of str
        Names of the views, in the sequence of axis v.
    index : (t, v)
        Segment of each view on each track, -1 if the view has none. One segment may be on several
        tracks, with different fragments.
    fragments_px : (t, v, 2, 2)
        Fragment of each segment, in pixels of the image: first ends correspond, and so do second
        ends. NaN if the view has none.
    lines_mm : (t, 2, 3)
        Ends of the line in space, world frame, for the part that at least two views show. The first
        end corresponds to the first ends of the fragments.
    covariance_mm2 : (t, 6, 6)
        Covariance of both ends.
    stage : (t,)
        "trinocular" for three or more views, "binocular" for two views.
    posterior : (t,)
        Probability that the match is right.
    rival_posterior : (t,)
        Posterior of the best rival, a match that uses the same part of a segment; 0 if there is
        none.
    reasons : dict of arrays
        For each view, the reason why each segment is on no track. "matched" for segments on a
        track. "matched within a pattern" if a match one period off is as good.
    counts : dict of int
        Numbers of candidates and tracks that each step produced and rejected, by name.
    fragments_covariance_px2 : (t, v, 4, 4) or None
        Covariance of the fragments' ends, NaN if the view has none. None if not available.
    misfit : (t,) or None
        Chi-square of the residuals of all views, with 2 (n - 2) degrees of freedom for n views; 0
        for two views. None if not available.
    viewpoint_dependent : (t,) or None
        True for tracks that probably show no line in space, but the outline of a round body or a
        highlight. For tracks in three views, the misfit exceeds that of 99 in 100 straight edges.
        For tracks in two views, a third view shows a segment near the predicted position, but none
        at this position. None if not available.
    member_posterior : (t, v) or None
        Probability that each segment belongs to the line of the track's other segments; NaN if the
        view has none. For tracks in two or three views, this is the track's posterior. None if not
        available.
    rig_covariance_mm2 : (t, 6, 6) or None
        Covariance that errors of the rig add to `covariance_mm2` (`with_rig_covariance`). These
        errors displace and turn the scene as a whole. None if not available.
    marks : dict of arrays
        Results of later steps by name, (t,) or (t, v): booleans, probabilities or strings. False, 0
        or "" if a view shows no line. Names in use: "measure" (`measure_lines`), "silhouette"
        (`find_rims`).
    noise_scale : float
        Standard deviation of the errors across the segments, estimated from three views, over the
        stated one. All covariances here include this factor. 1 for two views.
    noise_tail : float
        Inequality of the tracks' errors, estimated from three views: 1 / degrees of freedom of a
        Student distribution, 0 for normal errors. The covariances are scaled so that 95 %
        ellipsoids contain 95 % of the lines. Use `ellipsoid_limit` for other probabilities.
    notes : tuple of str
        Warnings about the whole set, for example about unexpected noise or collinear cameras.
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
                    _is_observed(table)[..., None, None], np.abs(ends) < LARGEST_PX, np.isnan(ends)
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
                    stage == np.where(_is_observed(table).sum(axis=1) > 2, TRINOCULAR, BINOCULAR)
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
            ColumnCheck(
                "is no covariance where a view sees the line", _are_covariances_where_observed
            )
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
                "is no probability where a view sees the line", _are_probabilities_where_observed
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
        """Overall result of the checks. With the status SUSPECT, the first note is the reason."""
        from trinoc.match.tracks.reliability import assess_matches

        return assess_matches(self).status

    @property
    def share_in_three_views(self) -> float:
        """Share of a view's segments on sure tracks in three or more views; the smallest of all
        views.

        A sure track has a posterior above 0.9. A small share in one view may mean that its
        camera was moved.
        """
        is_sure = (self.posterior > DecoyTuning.sure_posterior) & (self.stage == TRINOCULAR)
        return min(
            len(np.setdiff1d(view_index, -1)) / max(len(self.reasons[name]), 1)
            for name, view_index in zip(self.views, self.index[is_sure].T, strict=True)
        )

    @property
    def length_mm(self) -> Float[np.ndarray, "t"]:
        """Length of each line in space, (t,) mm."""
        return line_sigmas(self.lines_mm, self.covariance_mm2).length_mm

    @property
    def length_sigma_mm(self) -> Float[np.ndarray, "t"]:
        """Standard deviation of each length, (t,) mm."""
        return line_sigmas(self.lines_mm, self.covariance_mm2).length_sigma_mm

    @property
    def across_sigma_mm(self) -> Float[np.ndarray, "t"]:
        """Standard deviation of each line's midpoint, in the worst direction across the line, (t,)
        mm.
        """
        return line_sigmas(self.lines_mm, self.covariance_mm2).across_sigma_mm

    def ellipsoid_limit(self, probability: float) -> Float[np.ndarray, "t"]:
        """Limit of the squared error of each line that holds with the given probability, (t,).

        The squared error is d' C^-1 d: d are the four offsets of both ends from the true line,
        perpendicular to the line, and C is their covariance from `covariance_mm2`.

        Parameters
        ----------
        probability : float
            Probability, between 0 and 1.

        Returns
        -------
        (t,)
            Limit of each track. At 0.95, the limit is that of a normal distribution. With unequal
            errors (`noise_tail`), the limit is smaller below 0.95 and larger above.

        Raises
        ------
        InputError
            If the probability is not between 0 and 1.
        """
        if not 0 < probability < 1:
            raise InputError(f"probability is {probability}: give one between 0 and 1.")
        return ellipsoid_limit(probability, degrees_of_misfit(self.index), self.noise_tail)

    def wires(self) -> Wires:
        """Return the lines in space for drawing, each with two vertices."""
        pairs = np.arange(2 * len(self)).reshape(-1, 2)
        return Wires(self.lines_mm.reshape(-1, 3), pairs, np.arange(len(self)))

    def with_marks(self, **marks: Shaped[np.ndarray, "..."]) -> "Matches":
        """Return the same matches with marks added or replaced."""
        return replace(self, marks=self.marks | marks)

    def line_observations(self) -> LineObservations:
        """Return the tracks as observations of lines, the input of a joint refinement.

        Raises
        ------
        InputError
            If the matches have no covariance of their fragments.
        """
        if self.fragments_covariance_px2 is None:
            raise InputError(
                "These matches do not contain the covariance of their fragments, which refinement "
                "needs: match the segments again with this version."
            )
        return LineObservations(
            self.views,
            self.fragments_px,
            self.fragments_covariance_px2,
            self.index >= 0,
            self.lines_mm,
        )
