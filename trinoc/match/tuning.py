"""Every tuned constant of the matcher, in one frozen value that can be swept.

    tuning = with_field(MatchTuning(), "selection.damping", 0.5)     # trinoc.numerics
    matches = match_segments(segments, rig, tuning=tuning)

Each group says which figure shows it; `benchmarks/sweep.py` tries other values. Most values were
chosen by hand, on made scenes, or come from the prototype, a numerical study that went before; a
comment says where one was fitted or measured, and on what. Numbers of scales and of components
are fixed: tables have a column for each. Block sizes, the layers of the table of cells and
numerical guards stand where they are used, as no answer should depend on them.
"""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class ClutterTuning:
    """What segments that belong to nothing look like. Shown by merton1 and merton2, where texture
    is dense in places, and by the fresh scenes (benchmarks/matching.py)."""

    # Clutter is as dense about a segment as so many of its neighbours are. By hand.
    neighbours: int = 25


@dataclass(frozen=True)
class SideTuning:
    """Grey levels beside segments, in hundredths of the range of all levels. Shown by "with side
    levels" of merton1 and by the rendered scenes (benchmarks/matching.py --rendered)."""

    # Standard deviations with which the levels of one surface agree between views. By hand.
    agreeing: tuple[float, float, float] = (0.5, 2.0, 6.0)
    # Shares, before anything is learned, of how the one side agrees and how the other: pairs of
    # the three above and of "not at all", see `SIDE_COMPONENTS`. By hand; EM replaces them.
    prior_shares: tuple[float, ...] = (0.3, 0.15, 0.05, 0.15, 0.1, 0.04, 0.08, 0.03, 0.04, 0.06)
    # Percentiles of all levels that are 0 and 100. By hand.
    percentiles: tuple[float, float] = (2.0, 98.0)
    # Width of a bin of the histogram of clutter's levels, and the share of clutter that has any
    # level. By hand.
    bin_width: float = 2.0
    any_level_share: float = 0.05
    # Levels are as usual about a segment as among so many neighbours. By hand.
    neighbours: int = 25


@dataclass(frozen=True)
class CandidateTuning:
    """Step 1: which segments can be one line at all. Shown by row "1" of the fresh scenes and by
    "near epipolar" (benchmarks/matching.py); looser values cost time. Static in the kernels: one
    compilation for each value."""

    # Least common part, as a share of the shorter segment. From the prototype.
    smallest_overlap: float = 0.15
    # Chi-square (2 degrees of freedom) up to which three segments can be one line. By hand; one
    # in 22,000 true triples lies beyond if covariances are true.
    gate: float = 20.0
    # The gate in the picture, before the line is adjusted to all views, is so much wider. By hand.
    gate_slack: float = 1.1
    # The second longest segment is at least this share of the longest, on the line: chords of a
    # cylinder's rim against its silhouette are not. From the prototype.
    shortest_to_longest: float = 0.2
    # Sine of the least angle between the interpretation planes of a pair: below, its depth is
    # anything. By hand.
    smallest_crossing: float = 0.003
    # A pair that predicts worse than this in the third view predicts nothing, px. By hand, so
    # that short baselines predict too: their planes cross at small angles, all of them.
    vaguest_px: float = 6.0
    # Of the three orderings of a triple, that whose pair crosses best finds it, or one whose sine
    # is this share of the best. By hand.
    nearly_best: float = 0.8
    # The middle of a prediction may lie this share of the picture outside. By hand.
    outside_share: float = 0.1
    # Standard deviations within which a segment may lie of where a pair predicts it. By hand.
    reach_sigmas: float = 4.0
    # Predictions shorter than this are looked up in their middle alone, px. By hand.
    one_sample_px: float = 16.0
    # Of more candidates than this in one block, those with log odds below are not kept: most of
    # what passes the gate is wrong, and takes memory. By hand, for large scenes.
    prune_above: int = 5000
    prune_log_odds: float = -9.0
    # Of more candidates than this in all, the likelier half is kept: it bounds the memory, some
    # 2 kB for each. By hand; no scene of 10,000 segments per view has them.
    most_candidates: int = 1 << 20


@dataclass(frozen=True)
class EndTuning:
    """Where segments end along their line. Shown by the rows "ej5", ends cut by up to 5 px, and by
    merton1 and merton2 (benchmarks/matching.py). The scales are static in the kernels."""

    # Standard deviations with which the ends of all views agree, px. From the prototype, where
    # evidence of ends was the largest single gain.
    agreeing_px: tuple[float, float, float, float] = (0.7, 2.0, 5.0, 12.0)
    # The same where two views agree and the third stops short or runs on, px. By hand.
    pair_px: tuple[float, float, float] = (0.7, 2.0, 5.0)
    # Shares before anything is learned: all agree, by scale; the third stops short, by scale; it
    # runs on, by scale; none agree. By hand; EM replaces them.
    prior_shares: tuple[float, ...] = (
        *(0.35, 0.2, 0.08, 0.05),
        *(0.08, 0.05, 0.04),
        *(0.04, 0.03, 0.03),
        0.05,
    )


@dataclass(frozen=True)
class EvidenceTuning:
    """How evidence adds up to log odds. Shown by the calibration error and the reliability table
    (benchmarks/matching.py)."""

    # Real segments have heavy tails: their error is the stated one times one of these. From the
    # prototype (0.3 to 2), widened by hand so that wrong sigmas are made good.
    tail_scales: tuple[float, ...] = (0.2, 0.6, 1.0, 2.0, 4.0)
    # Share of each before anything is learned. By hand; EM replaces them.
    prior_tail: tuple[float, ...] = (0.05, 0.25, 0.5, 0.15, 0.05)
    # Prior shares count as so many observations; no share falls below the least. By hand.
    prior_observations: int = 10
    min_share: float = 1e-3
    # Least thickness of the box that holds the lines, as a share of its longest side, so that
    # lines of one plane leave a volume. By hand. The line map's box has the same.
    thinnest: float = 0.05
    # Standard deviations from the middle of the box to its corners, and the most that lying
    # outside costs, twice in log density. By hand.
    box_corner_sigmas: float = 3.0
    box_cost: float = 100.0
    # Added to the log odds of every triple, so that posteriors match the share that is right:
    # fitted on made scenes of other seeds than the benchmark's, by the reliability table.
    log_odds_offset: float = 1.0
    # Clutter of made scenes is independent; in pictures its pieces lie along one shadow or round
    # one body, and summed log odds are five times too high. Log odds of segments with known side
    # levels, which is to say from pictures, are multiplied by this: fitted on twelve rendered
    # scenes (seeds 0 to 5 and 12 to 17), for triples and for pairs alike.
    temperature: float = 0.2
    # Candidates less likely than this teach nothing. By hand.
    negligible: float = 1e-3
    # How often a segment's known darker side is not that of its line: a background that differs
    # between views, or a wrong sign. Measured: of partners in real pictures, 96.7 % agree.
    turned_share: float = 0.017
    # Lines in space are as near their true places as their covariances say, or worse by this
    # factor in this share of cases. By hand.
    loose_sigmas: float = 3.0
    loose_share: float = 0.15


@dataclass(frozen=True)
class JunctionTuning:
    """Ends that meet in space: they support each other in steps 2 and 3, and make the corners of
    the line map. Shown by rows "1" against "1+2", most of all of boxes ej5 and of tables
    (benchmarks/matching.py), and by the corners of benchmarks/joined_lines.py."""

    # Ends meet when they lie within this of each other, or of their corner, px. By hand.
    reach_px: float = 15.0
    # Sine of the least angle between lines that meet. From the prototype.
    smallest_sine: float = 0.15
    # How far ends stop from their junction, px, and how often each before it is known. By hand;
    # the shares are learned.
    gaps_px: tuple[float, float, float] = (1.0, 3.0, 8.0)
    prior_gaps: tuple[float, float, float] = (0.6, 0.3, 0.1)
    # Share of ends at a junction before it is known, and how many observations that counts for in
    # step 2. By hand.
    prior_at_junction: float = 0.5
    prior_observations: int = 5
    # Where a smaller share of ends is at junctions there is no structure to speak of, and they
    # are not used. From the prototype; shown by the rows "random", which have none.
    min_at_junction: float = 0.1


@dataclass(frozen=True)
class SelectionTuning:
    """Step 2: learning, exclusion, neighbours. Shown by rows "1" and "1+2" of the fresh scenes
    (benchmarks/matching.py)."""

    # Two candidates conflict where they share more than this of the shorter part of a segment.
    # From the prototype: none at all helps cut ends and breaks tables.
    conflict_overlap: float = 0.3
    # Damping of messages, from the prototype; rounds at most, and the change (log odds) at which
    # they have settled, by hand.
    damping: float = 0.3
    iterations: int = 20
    settled: float = 1e-2
    # Rounds of EM, and of junctions. By hand (the prototype took five).
    rounds: int = 4
    junction_rounds: int = 4
    # Candidates with log odds below these are let go: while parameters are learned, and after.
    # By hand (the prototype: -6), for time: few candidates have few conflicts.
    learn_log_odds: float = -2.0
    prune_log_odds: float = -5.0
    # Of more possible conflicts than this, the likeliest candidates are kept that have so many: it
    # bounds the memory, 40 bytes for each. By hand; no scene of 10,000 segments per view has them.
    most_conflicts: int = 1 << 25


@dataclass(frozen=True)
class NoiseTuning:
    """How much larger than stated the segments' errors are, learned from three views. Shown by
    the coverage of ellipsoids with wrong sigmas given (benchmarks/matching_truth.py)."""

    # Triples as likely as this tell, with so many that fit as stated beside them. By hand.
    sure: float = 0.9
    prior_observations: int = 10
    # Where errors are larger by more than this, candidates are found anew under the larger ones,
    # so often at most: the gate of the first has cut off what lies further out. And so where they
    # are much smaller. By hand; photographs, with their heavy tails, keep the wider gate.
    again_above: float = 1.2
    again_below: float = 0.2
    passes: int = 6
    # The most that one pass changes, and all together, up or down. By hand.
    largest: float = 10.0
    most: float = 25.0
    # Beyond this factor, up or down, a note says so.
    noted: float = 1.5


@dataclass(frozen=True)
class OcclusionTuning:
    """Step 3: pairs of views. Shown by "1+2+3" and "step 3 alone", and the calibration error
    (benchmarks/matching.py)."""

    # Rounds of marginals, prior and junctions. By hand.
    rounds: int = 6
    # With fewer lines than this in three views, nothing is learned from them. By hand.
    min_tracks_to_learn: int = 10
    # A segment of which less than this is matched may be half of a pair. From the prototype.
    max_matched_share: float = 0.5
    # Pairs before any is known, as a share of the lines matched in three views. By hand; learned.
    prior_share: float = 0.1
    # Probability that a view misses a line within its borders. By hand.
    missed: float = 0.5
    # Added to the log odds of every pair, so that posteriors match the share that is right:
    # fitted on made scenes (seeds from 700,000 on), better on four of five kinds of scene.
    log_odds_offset: float = 2.25
    # The same in two views, where no third checks: rates of lines by length, of ends and of
    # junctions are learned from the pairs in more rounds, beside so many usual ones; and however
    # well a pair fits, it is right no oftener than this: other edges, parallel ones and outlines
    # of round bodies, may fit as well. Both fitted on made scenes (seeds 8,000 to 8,009).
    log_odds_offset_alone: float = 1.0
    most_alone: float = 0.97
    rounds_alone: int = 10
    prior_observations: float = 10.0
    length_classes_px: tuple[float, ...] = (12.0, 18.0, 27.0, 40.0, 60.0, 90.0, 135.0)
    # The same for segments with side levels, of pictures, where clutter is alike: with
    # `EvidenceTuning.temperature` fitted on rendered scenes (seeds 0 to 5 and 12 to 17).
    log_odds_offset_in_images: float = -1.5


@dataclass(frozen=True)
class TrackTuning:
    """From selections to `Matches`. Shown by "What moves with the viewpoint" (docs/matching.md)
    and, for more than three views, by tests/match/test_match_segments.py."""

    # Up to so many views, every three of them are matched; beyond, each with so many nearest.
    # By hand, for time.
    all_triplets: int = 5
    nearest_views: int = 3
    # Rounds in which tracks grow into views that they lack, and join. By hand; few are needed.
    merge_rounds: int = 20
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


@dataclass(frozen=True)
class CollinearTuning:
    """Tracks joined to straight lines. Shown by "pairs of tracks joined" and by the errors of lines
    of benchmarks/joined_lines.py."""

    # Tracks are joined where that is as likely as this, and both are right as likely as that.
    min_posterior: float = 0.9
    trusted_posterior: float = 0.7
    # Pairs that differ by more than this (chi-square, 4 degrees of freedom) stay apart whatever
    # else is found on their lines. By hand.
    prune_chi_square: float = 60.0
    # A line that fits its segments as badly as this share of true lines does is none.
    significance: float = 1e-3
    # How often a line has another piece before it is known, for so many observations, learned in
    # so many rounds, and at most. By hand.
    prior_share: float = 0.1
    prior_observations: float = 10.0
    rounds: int = 3
    max_share: float = 0.9
    # Of pieces that a detector broke, gaps are spread exponentially with this mean, px; the rest
    # is hidden by something, with gaps of any length. By hand.
    break_px: float = 15.0
    broken_share: float = 0.7
    # Pieces of one line lie beside each other so seldom, and do so when they share more than this
    # of the shorter. By hand.
    beside_share: float = 0.1
    beside_overlap: float = 0.3
    # Lines within this angle, degrees, or within so many sigmas of it, count as parallel, but not
    # beyond the widest, degrees. By hand.
    parallel_deg: float = 3.0
    parallel_sigmas: float = 3.0
    widest_deg: float = 20.0
    # Lines further apart than this are not compared; those that differ by this chi-square (4
    # degrees of freedom) are surely others, and tell how dense parallel lines are. By hand.
    gate_sigmas: float = 6.0
    different: float = 25.0
    # So many nearest parallel lines tell how dense they are. By hand.
    nearest: int = 2
    # Segments err by more than they say: by one of these factors, in so many cases. By hand.
    # Smaller errors are not assumed, so that no covariance is smaller than the segments' own.
    error_scales: tuple[float, float, float] = (1.0, 2.0, 4.0)
    error_shares: tuple[float, float, float] = (0.85, 0.11, 0.04)


@dataclass(frozen=True)
class CornerTuning:
    """Ends snapped to corners, with `JunctionTuning`. Shown by the corners and the lengths of
    benchmarks/joined_lines.py."""

    # Ends meet where that is as likely as this, both lines' posteriors included.
    min_posterior: float = 0.9
    # Lines pass through one point no worse than this share of true corners do.
    significance: float = 1e-3
    # Observations that the prior share of ends at corners counts for, rounds of learning, and the
    # largest share. By hand.
    prior_observations: float = 10.0
    rounds: int = 3
    max_at_corner: float = 0.95
    # Standard deviation along its line of where a detector stops, px. By hand; free ends are
    # 6.9 px off in the median (docs/segments.md).
    free_end_px: float = 7.0


@dataclass(frozen=True)
class DepthTuning:
    """Faces of depth maps. No benchmark shows it."""

    # Ends nearer than this in the picture are one corner, px; lines nearer to a plane lie in it.
    # By hand.
    corner_px: float = 4.0
    # Sine of the least angle of a corner, and the most edges that a face has. By hand.
    smallest_sine: float = 0.1
    most_edges: int = 8


@dataclass(frozen=True)
class GuidedTuning:
    """Pictures asked again where lines must be. Shown by benchmarks/guided.py."""

    # Rounds at most; they end where nothing is added. By hand.
    rounds: int = 3
    # False alarms from noise that are expected in one picture, one round and one kind of question.
    false_alarms: float = 0.05
    # Only lines surer than this are lengthened, log odds. By hand.
    trusted_log_odds: float = 0.8
    # Beyond each end so much is asked, px and share of the segment, and never more than the
    # longest; the edge goes on within the gate of the segment's line, after a gap no longer than
    # this; a segment is not lengthened by less than the least gain, px. By hand.
    prolong_px: float = 24.0
    prolong_share: float = 0.3
    longest_px: float = 256.0
    prolong_gate_px: float = 1.0
    gap_px: float = 6.0
    corner_px: float = 4.0
    least_gain_px: float = 8.0
    least_piece_px: float = 7.9
    straight_px: float = 0.3
    gate: float = 9.2
    # Ends of lines that differ by this angle, degrees, and lie this near are a corner, px of the
    # picture that shows it largest; what a corner is off by at least, and along its line where
    # it is an end that meets nothing, px. By hand.
    meet_px: float = 4.0
    meet_deg: float = 10.0
    corner_floor_px: float = 0.2
    free_end_px: float = 3.0
    # New lines are asked for from each corner along so many lines about it, which may differ from
    # the partner's direction by this, degrees, in length by this share, and toward so many other
    # corners. By hand.
    partners: int = 14
    asked_again_mm: float = 1.0
    # A quick look must show so much in two pictures, mean standard deviations of the gradient's
    # noise, apart from what lies within this width, px, of matched segments. By hand, for time:
    # lines that were put out showed 1.5 and more.
    plausible_sigmas: float = 1.2
    # Then all pictures that show so much are asked, and the others show nothing. By hand.
    asked_sigmas: float = 0.7
    matched_width_px: int = 5
    # Directions nearer than this are one, degrees.
    same_direction_deg: float = 4.0
    usual_directions: int = 3
    parallel_deg: float = 0.3
    longer: float = 1.2
    corners: int = 8
    # Beside a projected line an edge is looked for within so many standard deviations, and so much
    # more, px. By hand.
    reach_sigmas: float = 2.5
    corner_gate_px: float = 0.5
    # A line is asked for in a further view where it is so long there, px, and an edge is its own
    # where it covers this share. By hand.
    shortest_px: float = 12.0
    least_covered: float = 0.4
    # With the further view a line keeps this share of its length. By hand.
    kept_share: float = 0.7
    # An edge found and a segment there are one within this distance and overlap. By hand.
    same_px: float = 1.2
    same_overlap: float = 0.5
    claimed_overlap: float = 0.3
    # Where lines beside a line are asked for, px across; what the answers weigh in log odds.
    control_px: tuple[float, ...] = (-11.0, -7.0, 7.0, 11.0)
    temperature: float = 0.5
    # How likely a line is that a quick look has chosen, and how likely a picture is to miss one.
    # By hand, on seeds 0 to 11.
    prior_new: float = 0.05
    # A new line is put out from these log odds on, where its views locate it as well as this, and
    # so near to where it was asked for, px, and no further from a corner than this share of what
    # was asked for. By hand.
    new_log_odds: float = 1.0
    largest_doubt: float = 0.5
    as_asked_px: float = 4.0
    corner_gap: float = 0.35
    # An edge in one picture counts beside a sure one in another where noise shows as much so
    # seldom.
    weak: float = 0.01
    missed: float = 0.5


@dataclass(frozen=True)
class MatchTuning:
    """All groups; the default is what everything was measured with."""

    clutter: ClutterTuning = field(default_factory=ClutterTuning)
    sides: SideTuning = field(default_factory=SideTuning)
    candidates: CandidateTuning = field(default_factory=CandidateTuning)
    ends: EndTuning = field(default_factory=EndTuning)
    evidence: EvidenceTuning = field(default_factory=EvidenceTuning)
    junctions: JunctionTuning = field(default_factory=JunctionTuning)
    selection: SelectionTuning = field(default_factory=SelectionTuning)
    noise: NoiseTuning = field(default_factory=NoiseTuning)
    occlusion: OcclusionTuning = field(default_factory=OcclusionTuning)
    tracks: TrackTuning = field(default_factory=TrackTuning)
    collinear: CollinearTuning = field(default_factory=CollinearTuning)
    corners: CornerTuning = field(default_factory=CornerTuning)
    depth: DepthTuning = field(default_factory=DepthTuning)
    guided: GuidedTuning = field(default_factory=GuidedTuning)


DEFAULT = MatchTuning()
