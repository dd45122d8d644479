"""Tuned constants of the tracks."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TrackTuning:
    """From selections to `Matches`. Shown by "Viewpoint-dependent tracks" (docs/matching.md)
    and, for more than three views, by tests/match/test_match_segments.py."""

    # Up to so many views, every three of them are matched; beyond, each with so many nearest.
    # By hand, for time.
    all_triplets: int = 5
    nearest_views: int = 3
    # Rounds in which tracks grow into views that they lack, and join. By hand; few are needed.
    merge_rounds: int = 20
    # Errors of tracks are unequal by this tail at most, and every segment lies so near its line, px
    # or standard deviations. By hand; shown by benchmarks/real_scenes.py ("members off by") and by
    # the published rows of the corridor that stay whole.
    largest_tail: float = 0.25
    # A track looks for segments up to this chi-square of 2 degrees of freedom at most, for time.
    widest_gate: float = 100.0
    farthest_px: float = 2.5
    farthest_sigmas: float = 3.0
    # A further view must show this share of a track's common part. By hand.
    min_shared: float = 0.5
    # A track is located where, in a pair of its views, the standard deviation of a segment's
    # direction is below this share of its angle to the epipolar line. Errors in space are larger
    # by a term of second order, this times the share squared, in variance. Fitted on made scenes
    # (seeds 2,000 to 5,019): 95 % ellipsoids of pairs hold 93 to 97 % at every angle, on others.
    largest_direction_doubt: float = 1.0
    second_order: float = 6.0
    # Where fewer lines are found than this share of a view's segments, and the cameras diverge,
    # those behind the cameras are counted: of a mirrored rig, they are all there. By hand.
    few_share: float = 0.1
    # A candidate within this much of log odds of a segment's best is a serious rival: in
    # `reasons` alone. By hand.
    rival_log_odds: float = 3.0
    # Share of straight lines, seen in three views, that are marked as moving by chance.
    significance: float = 0.01
    # Fewer tracks do not tell how large errors usually are. By hand.
    min_tracks_to_learn: int = 10
    # What a third view shows beside the place of a line of two views: this near, px, this nearly
    # parallel, degrees, and beside this share of the shorter. By hand; shown by the 3.5 % of
    # straight edges that are marked in two views.
    beside_px: float = 10.0
    beside_deg: float = 3.0
    abreast_share: float = 0.5
    # Centres lie on a line where they are off it by less than this share of their spread along it:
    # for a note. By hand.
    in_line_share: float = 0.05
    # Two cameras are nearly at one place where more than this share of the segments, the longest
    # of them, lie in both pictures, within so many sigmas, as if they were infinitely far: fewest
    # and most segments that are compared. In sets of three views or more, of pairs whose baseline
    # is below this share of the longest. For a note. By hand.
    narrow_share: float = 0.5
    narrow_sigmas: float = 3.0
    narrow_segments: tuple[int, int] = (5, 200)
    narrow_baselines: float = 0.05
    # What makes matches usable (`assess_matches`). So many sure lines in three views: each has two
    # numbers to spare, of which an error of one camera takes six from all. By hand.
    fewest_sure: int = 5
    # And a median sigma across these lines below this share of the scene's extent. By hand: ten
    # real scenes show .1 to .5 % in three views, a camera that moves along its axis 1.9 %.
    largest_sigma_of_scene: float = 0.03


@dataclass(frozen=True)
class ViewSupportTuning:
    """More than three views: which of them show a track. Shown by benchmarks/real_scenes.py."""

    # Of fewer tracks nothing is learned. By hand.
    fewest_tracks: int = 10
    # Number of copies of tracks, and the shares of the depth by which they are moved. By hand.
    copies: int = 600
    moved: tuple[float, float] = (0.08, 0.2)
    # Rates before they are known, and how many lines these count for. By hand.
    prior_right: float = 0.7
    prior_chance: float = 0.1
    prior_lines: float = 5.0
    # No rate is larger: a detector misses lines that another view shows. By hand.
    largest_rate: float = 0.95
    # Weights of the evidence of views, which are not independent, and of a misfit. Chosen on two
    # real scenes of six views, a robot cell and a house front, by how often views that were held
    # out support a track; shown by other scenes.
    weight_of_views: float = 0.3
    weight_of_misfit: float = 0.4


@dataclass(frozen=True)
class DecoyTuning:
    """Whether a set of segments belongs to a rig. Shown by benchmarks/mixed_sets.py. By hand, on
    its seeds 11 and 12, on merton1, merton2 and four triples of views of the corridor."""

    # Tracks as likely as this are sure; of fewer segments in a view nothing is said.
    sure: float = 0.9
    fewest_segments: int = 20
    # Where so large a share of the segments is sure in three views, or where so many tracks are as
    # likely as `certain`, no decoy is matched. Right sets show .46 to .95, mixed ones up to .2; of
    # mixed ones up to 2 tracks are that likely, of pictures shifted by 14 px 6.
    clear_share: float = 0.5
    clear_certain: int = 8
    # A set needs so many times the decoys' mean, so many standard deviations of a count of it, and
    # so many more; and where its share is below `few_share`.
    some: tuple[float, float, float] = (1.5, 3.0, 2.0)
    few: tuple[float, float, float] = (2.0, 5.0, 5.0)
    few_share: float = 0.25
    # Or so many as likely as this, by the same three numbers: on mixed sets of seeds 621 to 628 up
    # to 3 are, of pictures shifted by a few px more; on right ones of little overlap 1 to 17 of few
    # lines, from 70 on of many.
    certain: float = 0.999
    of_certain: tuple[float, float, float] = (2.0, 3.0, 4.0)
    # Where errors are so many times those stated, shifts are tried, of sets that are not clear from
    # the first on: of such, right ones show up to 1.24, shifted ones from 1.41. Where they are so
    # many times and the share is below this, the rig has moved. Noise understated by two shows up
    # to 2.2.
    shifted_above: float = 1.3
    noisy_above: float = 2.0
    moved_above: float = 2.5
    noisy_share: float = 0.7
    # A mistake is the cause where, with it undone, so many times the sure lines are found, and so
    # many more; or more of them with errors below this share. Tried on so many segments of a view,
    # and with so many passes over their noise, for time.
    explained: tuple[float, float] = (1.25, 5.0)
    quieter: float = 0.6
    tried_segments: int = 250
    passes: int = 2
    # A shift is told by the ends of segments parallel to lines of the other views, within this many
    # degrees: by differences of up to so many px that agree within this many. Its median settles in
    # so many rounds, and below so many px it is none.
    parallel_deg: float = 3.0
    reach_px: float = 80.0
    agree_px: float = 3.0
    shift_rounds: int = 5
    least_shift_px: float = 2.0
