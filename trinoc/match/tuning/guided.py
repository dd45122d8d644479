"""Tuned constants of guided detection."""

from dataclasses import dataclass


@dataclass(frozen=True)
class GuidedTuning:
    """Pictures asked again where lines must be. Shown by benchmarks/guided.py."""

    # Rounds at most; they end where nothing is added. By hand.
    rounds: int = 2
    # False alarms from noise that are expected in one picture, one round and one kind of question.
    false_alarms: float = 0.05
    # Beyond each end so much is asked, px and share of the segment. By hand.
    prolong_px: float = 24.0
    prolong_share: float = 0.3
    # A chi-square of a track above this, or larger by so much, is a disagreement.
    gate: float = 9.2
    # Ends of lines of two directions that lie this near are a corner, px of the picture that shows
    # it largest; there nothing is lengthened, elsewhere an edge goes on after a gap no longer than
    # this, and an end that meets nothing is known so well along its line; so near to where it was
    # asked for is a new line. By hand.
    meet_px: float = 4.0
    # Directions nearer than this are one, degrees.
    same_direction_deg: float = 4.0
    # New lines are asked for from each corner along so many lines about it. By hand.
    partners: int = 14
    # A quick look must show so much in two pictures, mean standard deviations of the gradient's
    # noise, apart from what matched segments show. By hand, for time: lines that were put out
    # showed 1.5 and more.
    plausible_sigmas: float = 1.2
    # Beside a projected line an edge is looked for within so many standard deviations. By hand.
    reach_sigmas: float = 2.5
    # An edge, and a line that is asked for, is longer than this, px: with pieces of 8 px precision
    # is .004 less, on rendered pictures of seeds 18 to 25 and 210 to 213.
    shortest_px: float = 12.0
    # An edge found and a segment there are one within this distance and overlap. By hand.
    same_px: float = 1.2
    same_overlap: float = 0.5
    # How likely a line is that a quick look has chosen. By hand, on seeds 0 to 11.
    prior_new: float = 0.05
    # A new line is put out from these log odds on.
    new_log_odds: float = 1.0
    # An edge in one picture counts beside a sure one in another where noise shows as much so
    # seldom.
    weak: float = 0.01
    # Standard deviation of the smoothing, px: with the blur of usual pictures the profile of an
    # edge is some 1.5 px wide. By hand.
    smoothing_px: float = 1.2
    # A block whose shoulders differ by this share of the ridge's height more than by noise, which
    # is as much again, has half the weight: another edge is beside it. By hand.
    unlike_share: float = 0.05
    # Score above which an edge is no surer for being stronger: the nearest of such is the line's
    # own. By hand.
    sure_score: float = 8.0
    # An edge that crosses the line has a gradient along it: at most this share of that across. By
    # hand.
    oblique_share: float = 0.3
    # Of the place across, what noise does not explain: sampling and interpolation, px; and how far
    # an edge beside it moves the ridge, px by the difference of both shoulders as a share of its
    # height. On edges of rendered pictures, seeds 0 to 11 and others.
    floor_px: float = 0.03
    pull_px: float = 0.7
    # Blocks of a probe tell their sigma like so many independent ones; below this excess it is
    # chance. By hand.
    block_degrees: int = 12
    known_below: float = 1.3
