"""Can these matches be used? One answer for status, text, records, reports and exit codes.

Two things decide: evidence that segments and rig do not belong together, and how uncertain the
lines are against the scene that they span. The share of segments that are matched decides nothing:
in a cluttered scene it is small although the lines are right.
"""

from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.match.tracks.answers import MATCHED, OUTSIDE
from trinoc.match.tracks.matches import SUSPECT_SETS, TRINOCULAR, Matches, MatchStatus
from trinoc.match.tuning.tracks import DecoyTuning, TrackTuning

# numerical: the share of the ends that the ball holds whose diameter is the scene's extent.
MOST_ENDS = 0.9

Topic = Literal["rig", "set", "count", "agreement", "uncertainty"]


class MatchFinding(NamedTuple):
    """One question about a set of matches: the status that it alone would give, and why.

    `remedy` is empty where the status is MATCHED.
    """

    topic: Topic
    status: MatchStatus
    figure: str
    words: str
    remedy: str = ""

    @property
    def reason(self) -> str:
        """Figure and words as one sentence."""
        return f"{self.figure}: {self.words}"


class MatchAssessment(NamedTuple):
    """The verdict on matches: that of the worst finding, the first of these; of good ones the last.

    `findings` holds all of them.
    """

    status: MatchStatus
    deciding: MatchFinding
    findings: tuple[MatchFinding, ...]

    @property
    def sentence(self) -> str:
        """The verdict, the number that decides, and what to do."""
        parts = (self.status.value, self.deciding.reason, self.deciding.remedy)
        return " ".join(part for part in parts if part)


def assess_matches(matches: Matches, doubts: Mapping[str, str] | None = None) -> MatchAssessment:
    """Assess whether matches can be used.

    Parameters
    ----------
    doubts : for each camera whose calibration was suspect, why.
    """
    chosen = _choose_lines(matches)
    findings = [
        *_find_doubts(doubts or {}),
        *_find_evidence(matches),
        _find_count(matches, chosen),
        *_find_disagreement(matches),
        *_find_uncertainty(matches, chosen),
    ]
    for status in (MatchStatus.SUSPECT, MatchStatus.UNCERTAIN):
        for finding in findings:
            if finding.status is status:
                return MatchAssessment(status, finding, tuple(findings))
    return MatchAssessment(MatchStatus.MATCHED, findings[-1], tuple(findings))


def scene_extent_mm(lines_mm: Float[np.ndarray, "t 2 3"]) -> float:
    """Diameter of the ball about the median end that holds nine tenths of the ends."""
    ends = lines_mm.reshape(-1, 3)
    distance = np.linalg.norm(ends - np.median(ends, axis=0), axis=1)
    return 2 * float(np.quantile(distance, MOST_ENDS))


def say_excluded_depths(matches: Matches) -> str | None:
    """What to check where the allowed depths leave out more segments than are matched."""
    words = np.concatenate([np.asarray(words, dtype=str) for words in matches.reasons.values()])
    excluded = int((words == OUTSIDE).sum())
    if excluded <= np.char.startswith(words, MATCHED).sum():
        return None
    return (
        f"{excluded} segments have no partner in the depths allowed: check depth_range_mm, which "
        "is from each camera, in mm."
    )


def _choose_lines(matches: Matches) -> Bool[np.ndarray, "t"]:
    """Sure tracks of three views or more; of two views, where there is no third."""
    sure = np.asarray(matches.posterior) > DecoyTuning.sure
    return sure if len(matches.views) < 3 else sure & (np.asarray(matches.stage) == TRINOCULAR)


def _find_doubts(doubts: Mapping[str, str]) -> list[MatchFinding]:
    if not doubts:
        return []
    name, why = next(iter(doubts.items()))
    words = f"the calibration of {name} was suspect. {why[:1].upper()}{why[1:]}".rstrip()
    remedy = (
        "The segments in space inherit this error, and their sigmas do not hold it: calibrate "
        "again."
    )
    return [MatchFinding("rig", MatchStatus.UNCERTAIN, f"{len(doubts)} suspect", words, remedy)]


def _find_evidence(matches: Matches) -> list[MatchFinding]:
    """What `check_set` has against the set; its note names the remedy where it knows the cause."""
    if not matches.counts.get(SUSPECT_SETS):
        return []
    words = matches.notes[0] if matches.notes else "segments and rig do not belong together."
    remedy = "No posterior here is above 0.5: remove the cause and match again."
    return [MatchFinding("set", MatchStatus.SUSPECT, "SUSPECT", words, remedy)]


def _find_count(matches: Matches, chosen: Bool[np.ndarray, "t"]) -> MatchFinding:
    count = int(chosen.sum())
    if len(matches.views) < 3:
        return MatchFinding(
            "count",
            MatchStatus.UNCERTAIN,
            f"{count} sure lines in both views",
            f"of {len(matches)} tracks. Chance gives lines in two views too, and no third view "
            "tells them apart.",
            "Check that this rig took these pictures, or add a third camera.",
        )
    share = f"{100 * matches.share_in_three_views:.0f} %"
    figure = f"{count} sure lines in three views or more"
    words = f"of {len(matches)} tracks, with {share} of the segments of the poorest view on them."
    if count >= TrackTuning.fewest_sure:
        return MatchFinding("count", MatchStatus.MATCHED, figure, words)
    remedy = say_excluded_depths(matches) or (
        f"{TrackTuning.fewest_sure} are needed: check that this rig took these pictures of one "
        "scene, that each name stands before its own picture, and that no camera was moved "
        "(trinoc check)."
    )
    return MatchFinding("count", MatchStatus.UNCERTAIN, figure, words, remedy)


def _find_disagreement(matches: Matches) -> list[MatchFinding]:
    if (np.asarray(matches.stage) != TRINOCULAR).all():
        return []
    figure = f"{matches.noise_scale:.2f} times their sigma"
    words = (
        "by which the views place a segment differently; near 1 they agree as well as the "
        "segments were measured."
    )
    if matches.noise_scale <= DecoyTuning.noisy_above:
        return [MatchFinding("agreement", MatchStatus.MATCHED, figure, words)]
    remedy = (
        "A camera may have been knocked (run trinoc check), the pictures are sharpened or moved, "
        "or the segments' sigma is stated too small; the sigmas of the lines have grown to match."
    )
    return [MatchFinding("agreement", MatchStatus.UNCERTAIN, figure, words, remedy)]


def _find_uncertainty(matches: Matches, chosen: Bool[np.ndarray, "t"]) -> list[MatchFinding]:
    if not chosen.any():
        return []
    sigma = float(np.median(np.nan_to_num(matches.across_sigma_mm[chosen], nan=np.inf)))
    extent = scene_extent_mm(np.asarray(matches.lines_mm)[chosen])
    figure = "± not known"
    if np.isfinite(sigma):
        figure = f"± {_length(sigma)}, {100 * sigma / max(extent, sigma):.2g} % of the scene"
    words = (
        f"the median sigma across the {int(chosen.sum())} sure lines, nine tenths of whose ends "
        f"lie within {_length(extent)}."
    )
    if sigma <= TrackTuning.largest_sigma_of_scene * extent:
        return [MatchFinding("uncertainty", MatchStatus.MATCHED, figure, words)]
    remedy = (
        "Put the cameras farther apart or nearer to the scene, or take pictures of more pixels; "
        "if positions are still good enough for you, each line has its own covariance."
    )
    return [MatchFinding("uncertainty", MatchStatus.UNCERTAIN, figure, words, remedy)]


def _length(value_mm: float) -> str:
    """A length to two digits, or whole millimetres."""
    return f"{value_mm:,.0f} mm" if value_mm >= 10 else f"{value_mm:.2g} mm"
