"""Tuned constants of the tracks, of view support and of decoys."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TrackTuning:
    """Tuned constants of tracks, of the reasons of unmatched segments, and of the checks of
    matches.

    Their effect is visible in "Viewpoint-dependent tracks" of docs/matching.md. For more than three
    views, tests/match/test_match_segments.py depends on them.
    """

    # Up to this number of views, all triplets are matched. With more, each view is matched with
    # this number of nearest views. By hand, for time.
    max_views_all_triplets: int = 5
    nearest_views: int = 3
    # Rounds of extending and joining tracks. By hand; few are needed.
    merge_rounds: int = 20
    # Largest tail of the tracks' errors. By hand; shown by benchmarks/real_scenes.py ("members off
    # by") and by the published rows of the corridor that stay complete.
    max_tail: float = 0.25
    # Largest chi-square (2 degrees of freedom) of a segment that a track searches for, for time.
    max_gate: float = 100.0
    # Largest distance of a segment from its line: the larger of these, in px and in standard
    # deviations. By hand.
    max_distance_px: float = 2.5
    max_distance_sigmas: float = 3.0
    # Share of a track's common part that a further view must show. By hand.
    min_shared_part: float = 0.5
    # A track is located if the standard deviation of a segment's direction over its angle to the
    # epipolar line is below this, in one pair of its views. The second order of errors in space
    # adds this factor times the ratio squared to the variance. Fitted on simulated scenes (seeds
    # 2,000 to 5,019). On others, 95 % ellipsoids of pairs contain 93 to 97 % at every angle.
    max_direction_doubt: float = 1.0
    second_order: float = 6.0
    # If the cameras diverge and there are fewer lines than this share of a view's segments, lines
    # behind the cameras are counted: a mirrored rig has all of its lines there. By hand.
    mirror_test_share: float = 0.1
    # A candidate whose log odds are less than this below a segment's best counts as a rival, in
    # `reasons` only. By hand.
    rival_log_odds: float = 3.0
    # Share of straight lines in three views that are marked as viewpoint-dependent by chance.
    significance: float = 0.01
    # Smallest number of tracks for an estimate of their usual errors. By hand.
    min_tracks_to_learn: int = 10
    # Segment of a third view beside the predicted line of two views: largest distance, px; largest
    # angle, degrees; smallest overlap, as a share of the shorter. By hand; 3.5 % of straight edges
    # in two views are marked.
    beside_px: float = 10.0
    beside_deg: float = 3.0
    abreast_share: float = 0.5
    # Camera centres are collinear if they deviate from a line by less than this share of their
    # extent. For a note. By hand.
    collinear_share: float = 0.05
    # Two cameras are nearly at one position if more than this share of the longest segments
    # coincides in both images, within so many sigmas, as at infinite depth. `narrow_segments` are
    # the smallest and largest numbers of segments that are compared. With three views or more, only
    # pairs with a baseline below `narrow_baselines` of the longest one are tested. For a note. By
    # hand.
    narrow_share: float = 0.5
    narrow_sigmas: float = 3.0
    narrow_segments: tuple[int, int] = (5, 200)
    narrow_baselines: float = 0.05
    # Usable matches (`assess_matches`) have at least this number of sure lines in three views. Each
    # gives two redundant numbers; an error of one camera has six parameters. By hand.
    min_sure_lines: int = 5
    # They also have a median sigma across these lines below this share of the scene's extent. By
    # hand: ten real scenes have 0.1 to 0.5 % in three views, a camera that moves along its axis
    # 1.9 %.
    max_sigma_of_scene: float = 0.03


@dataclass(frozen=True)
class ViewSupportTuning:
    """Tuned constants of the evidence from more than three views: hits and misses on a track.

    Their effect is visible in benchmarks/real_scenes.py.
    """

    # Smallest number of tracks for an estimate. By hand.
    min_tracks: int = 10
    # Number of random lines (displaced tracks), and range of their displacement, as shares of the
    # depth. By hand.
    copies: int = 600
    displacement: tuple[float, float] = (0.08, 0.2)
    # Prior rates of true and of random lines, and number of lines that they count as. By hand.
    prior_true_rate: float = 0.7
    prior_random_rate: float = 0.1
    prior_lines: float = 5.0
    # Largest rate: a detector misses lines that another view shows. By hand.
    max_rate: float = 0.95
    # Weights of the evidence of views, which are not independent, and of the misfit. Chosen on two
    # real scenes of six views, a robot cell and a house front, by the support of held-out views;
    # shown by other scenes.
    weight_of_views: float = 0.3
    weight_of_misfit: float = 0.4


@dataclass(frozen=True)
class DecoyTuning:
    """Tuned constants of the test whether segments and rig belong together.

    Their effect is visible in benchmarks/mixed_sets.py. They were chosen by hand on its seeds 11
    and 12, on merton1, merton2 and four view triplets of the corridor.
    """

    # Posterior of a sure track. Views with fewer segments are not tested.
    sure_posterior: float = 0.9
    min_segments: int = 20
    # No decoy is matched if this share of the segments is sure in three views, or if this number of
    # tracks is nearly certain (`certain_posterior`). Right sets have shares of 0.46 to 0.95, mixed
    # ones up to 0.2. Mixed sets have up to 2 nearly certain tracks, images shifted by 14 px have 6.
    clear_share: float = 0.5
    clear_certain: int = 8
    # Number of sure tracks that a set needs: a factor of the decoys' mean, plus a number of Poisson
    # standard deviations, plus a constant. The strict rule is for shares below `few_share`.
    usual_rule: tuple[float, float, float] = (1.5, 3.0, 2.0)
    strict_rule: tuple[float, float, float] = (2.0, 5.0, 5.0)
    few_share: float = 0.25
    # Posterior of a nearly certain track, and the same rule for their number. Mixed sets of seeds
    # 621 to 628 have up to 3, images shifted by a few px more. Right sets with little overlap have
    # 1 to 17 for few lines, and from 70 for many.
    certain_posterior: float = 0.999
    certain_rule: tuple[float, float, float] = (2.0, 3.0, 4.0)
    # Noise scales. Above the first, shifts are tested in sets that are not clear: right sets have
    # up to 1.24, shifted ones at least 1.41. Above the second, they are tested in all sets. Above
    # the third, with a share below `noisy_share`, the rig has changed. Noise understated by a
    # factor of two gives up to 2.2.
    shifted_above: float = 1.3
    noisy_above: float = 2.0
    moved_above: float = 2.5
    noisy_share: float = 0.7
    # A mistake is the cause if its correction gives this factor times the sure lines, plus a
    # constant; or more lines, with errors below this share. Then the number of segments of a view
    # in the sample, and of passes over the noise, for time.
    correction_rule: tuple[float, float] = (1.25, 5.0)
    quieter_share: float = 0.6
    sample_size: int = 250
    passes: int = 2
    # Estimate of a shift: largest angle of parallel segments, degrees; largest shift, px; tolerance
    # of agreeing offsets, px; rounds of the median; smallest shift, px.
    parallel_deg: float = 3.0
    shift_range_px: float = 80.0
    shift_tolerance_px: float = 3.0
    shift_rounds: int = 5
    min_shift_px: float = 2.0
