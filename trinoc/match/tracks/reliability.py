"""Checks of a set of matches. Status, text, records, reports and exit codes use the same result.

Two properties determine the status. The first is evidence that segments and rig do not belong
together. The second is the uncertainty of the lines relative to the extent of the scene. The share
of matched segments has no influence: in a cluttered scene the share is small although the lines are
right.
"""

from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.match import sentences
from trinoc.match.tracks.answers import MATCHED, OUTSIDE
from trinoc.match.tracks.matches import SUSPECT_SETS, TRINOCULAR, Matches, MatchStatus
from trinoc.match.tuning.tracks import DecoyTuning, TrackTuning

# numerical: share of the ends inside the ball whose diameter is the extent of the scene.
SHARE_OF_ENDS = 0.9

Topic = Literal["rig", "set", "count", "agreement", "uncertainty"]


class MatchFinding(NamedTuple):
    """Result of one check of a set of matches.

    Attributes
    ----------
    topic : str
        Subject of the check.
    status : MatchStatus
        Status that the check alone would give.
    figure : str
        Main number of the check, as text.
    explanation : str
        Meaning of the number.
    remedy : str
        Advice to the user; empty if the status is MATCHED.
    """

    topic: Topic
    status: MatchStatus
    figure: str
    explanation: str
    remedy: str = ""

    @property
    def reason(self) -> str:
        """Figure and explanation as one sentence."""
        return f"{self.figure}: {self.explanation}"


class MatchAssessment(NamedTuple):
    """Overall result of all checks of a set of matches.

    Attributes
    ----------
    status : MatchStatus
        The worst status of all findings.
    deciding : MatchFinding
        First finding with this status; the last finding if all are MATCHED.
    findings : tuple of MatchFinding
        Results of all checks.
    """

    status: MatchStatus
    deciding: MatchFinding
    findings: tuple[MatchFinding, ...]

    @property
    def sentence(self) -> str:
        """Status, reason and remedy as text."""
        parts = (self.status.value, self.deciding.reason, self.deciding.remedy)
        return " ".join(part for part in parts if part)


def assess_matches(matches: Matches, doubts: Mapping[str, str] | None = None) -> MatchAssessment:
    """Check whether matches can be used, and return the status with the reason.

    Parameters
    ----------
    matches : Matches
        The matches.
    doubts : mapping, optional
        For each camera with a SUSPECT calibration, the reason.

    Returns
    -------
    MatchAssessment
        Overall status and all findings.
    """
    is_chosen = _sure_lines(matches)
    findings = [
        *_rig_findings(doubts or {}),
        *_set_findings(matches),
        _count_finding(matches, is_chosen),
        *_agreement_findings(matches),
        *_uncertainty_findings(matches, is_chosen),
    ]
    for status in (MatchStatus.SUSPECT, MatchStatus.UNCERTAIN):
        for finding in findings:
            if finding.status is status:
                return MatchAssessment(status, finding, tuple(findings))
    return MatchAssessment(MatchStatus.MATCHED, findings[-1], tuple(findings))


def scene_extent_mm(lines_mm: Float[np.ndarray, "t 2 3"]) -> float:
    """Return the extent of a scene: diameter of a ball with nine tenths of the line ends, mm.

    The centre of the ball is the median end.
    """
    ends = lines_mm.reshape(-1, 3)
    distance = np.linalg.norm(ends - np.median(ends, axis=0), axis=1)
    return 2 * float(np.quantile(distance, SHARE_OF_ENDS))


def depth_range_remedy(matches: Matches) -> str | None:
    """Return the advice to check the depth range, or None.

    The advice is returned if the depth range excludes more segments than are matched.
    """
    reasons = np.concatenate(
        [np.asarray(view_reasons, dtype=str) for view_reasons in matches.reasons.values()]
    )
    excluded = int((reasons == OUTSIDE).sum())
    if excluded <= np.char.startswith(reasons, MATCHED).sum():
        return None
    return sentences.depth_range_excludes(excluded)


def _sure_lines(matches: Matches) -> Bool[np.ndarray, "t"]:
    """Return the mask of the sure tracks (posterior above 0.9), (t,).

    With three or more views, only tracks in at least three views are included.
    """
    is_sure = np.asarray(matches.posterior) > DecoyTuning.sure_posterior
    return (
        is_sure if len(matches.views) < 3 else is_sure & (np.asarray(matches.stage) == TRINOCULAR)
    )


def _rig_findings(doubts: Mapping[str, str]) -> list[MatchFinding]:
    if not doubts:
        return []
    name, doubt = next(iter(doubts.items()))
    explanation = sentences.calibration_suspect(name, doubt)
    return [
        MatchFinding(
            "rig",
            MatchStatus.UNCERTAIN,
            f"{len(doubts)} suspect",
            explanation,
            sentences.CALIBRATE_AGAIN,
        )
    ]


def _set_findings(matches: Matches) -> list[MatchFinding]:
    """Return the finding that segments and rig do not belong together, or an empty list.

    The explanation is the note of `check_set`, which contains the remedy if the cause is known.
    """
    if not matches.counts.get(SUSPECT_SETS):
        return []
    explanation = matches.notes[0] if matches.notes else sentences.DO_NOT_BELONG
    return [
        MatchFinding("set", MatchStatus.SUSPECT, "SUSPECT", explanation, sentences.REMOVE_THE_CAUSE)
    ]


def _count_finding(matches: Matches, is_chosen: Bool[np.ndarray, "t"]) -> MatchFinding:
    count = int(is_chosen.sum())
    if len(matches.views) < 3:
        return MatchFinding(
            "count",
            MatchStatus.UNCERTAIN,
            f"{count} sure lines in both views",
            sentences.only_two_views(len(matches)),
            sentences.ADD_A_CAMERA,
        )
    figure = f"{count} sure lines in three views or more"
    explanation = sentences.sure_lines(
        len(matches), matches.share_in_three_views, DecoyTuning.sure_posterior
    )
    if count >= TrackTuning.min_sure_lines:
        return MatchFinding("count", MatchStatus.MATCHED, figure, explanation)
    remedy = depth_range_remedy(matches) or sentences.too_few_sure_lines(TrackTuning.min_sure_lines)
    return MatchFinding("count", MatchStatus.UNCERTAIN, figure, explanation, remedy)


def _agreement_findings(matches: Matches) -> list[MatchFinding]:
    if (np.asarray(matches.stage) != TRINOCULAR).all():
        return []
    figure = f"{matches.noise_scale:.2f} times their sigma"
    explanation = sentences.VIEWS_DISAGREE_BY
    if matches.noise_scale <= DecoyTuning.noisy_above:
        return [MatchFinding("agreement", MatchStatus.MATCHED, figure, explanation)]
    return [
        MatchFinding(
            "agreement",
            MatchStatus.UNCERTAIN,
            figure,
            explanation,
            sentences.CHECK_THE_ERRORS,
        )
    ]


def _uncertainty_findings(matches: Matches, is_chosen: Bool[np.ndarray, "t"]) -> list[MatchFinding]:
    if not is_chosen.any():
        return []
    sigma = float(np.median(np.nan_to_num(matches.across_sigma_mm[is_chosen], nan=np.inf)))
    extent = scene_extent_mm(np.asarray(matches.lines_mm)[is_chosen])
    figure = "± not known"
    if np.isfinite(sigma):
        figure = f"± {_format_length(sigma)}, {100 * sigma / max(extent, sigma):.2g} % of the scene"
    explanation = sentences.sigma_of_lines(int(is_chosen.sum()), _format_length(extent))
    if sigma <= TrackTuning.max_sigma_of_scene * extent:
        return [MatchFinding("uncertainty", MatchStatus.MATCHED, figure, explanation)]
    return [
        MatchFinding(
            "uncertainty",
            MatchStatus.UNCERTAIN,
            figure,
            explanation,
            sentences.REDUCE_THE_SIGMA,
        )
    ]


def _format_length(value_mm: float) -> str:
    """Format a length in mm: no decimals from 10 mm on, two significant digits below."""
    return f"{value_mm:,.0f} mm" if value_mm >= 10 else f"{value_mm:.2g} mm"
