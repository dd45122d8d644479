"""Tuned constants of step 2: junctions, learning and exclusion, patterns, noise."""

from dataclasses import dataclass


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
    # Of more meetings of ends than this, those of the likelier candidates are kept: it bounds the
    # memory, some 200 bytes for each. By hand.
    most_meetings: int = 1 << 20
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
    most_conflicts: int = 1 << 22


@dataclass(frozen=True)
class RepetitionTuning:
    """Patterns that repeat along epipolar lines. Shown by benchmarks/repetition.py, on whose seeds
    1 to 3 it was chosen, the last on seed 1, beside boxes, loose lines and blocks (seeds 701 to
    703)."""

    # Candidates of such log odds are asked whether they are contested, and a rival of such log odds
    # contests those that surpass it by less than the second.
    likely_log_odds: float = 4.0
    nearly_log_odds: float = 3.0
    # So many of them about a place are asked: of 25, ordinary scenes show many by chance.
    neighbours: int = 50
    # Share of them that is contested in ordinary scenes and in patterns. Measured: medians of .0 to
    # .1, of .2 to .4 in walls before cameras in one line, whose sure tracks were wrong most often,
    # and of .4 to .9. Log odds of a pattern before they are asked: few lines say little.
    contested_shares: tuple[float, float] = (0.12, 0.4)
    prior_log_odds: float = -3.0
    # Log odds of a track of a pattern: two in seven are right.
    greatest_log_odds: float = -0.9


@dataclass(frozen=True)
class NoiseTuning:
    """How much larger than stated the segments' errors are, learned from three views. Shown by
    the coverage of ellipsoids with wrong sigmas given (benchmarks/matching_truth.py)."""

    # Triples as likely as this tell, with so many that fit as stated beside them. By hand.
    sure: float = 0.9
    prior_observations: int = 10
    # Segments tell where less than this share of their variance is common to all pictures. By hand.
    common_share: float = 0.5
    # Where errors are larger by more than this, candidates are found anew under the larger ones,
    # so often at most: the gate of the first has cut off what lies further out. And so where they
    # are much smaller. By hand; photographs, with their heavy tails, keep the wider gate.
    again_above: float = 1.2
    again_below: float = 0.2
    passes: int = 6
    # The most that one pass changes, and all together, up or down. By hand.
    largest: float = 10.0
    most: float = 25.0
    # Tail of the errors (one over degrees of freedom) before it is known: shape and mean of a gamma
    # distribution, where segments are found in pictures and where nothing says so. The first is
    # fitted to rendered seeds 0 to 11 and 200 to 205, the second by hand: made errors are normal.
    tail_of_pictures: tuple[float, float] = (3.0, 0.25)
    tail_otherwise: tuple[float, float] = (1.0, 0.01)
    # Beyond this factor, up or down, a note says so.
    noted: float = 1.5
