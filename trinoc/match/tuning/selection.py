"""Tuned constants of step 2: junctions, selection, repeated patterns, noise."""

from dataclasses import dataclass


@dataclass(frozen=True)
class JunctionTuning:
    """Tuned constants of junctions, line ends that meet in space.

    Junctions are evidence in steps 2 and 3, and form the corners. The effect of the constants is
    visible in benchmarks/matching.py: rows "1" and "1+2", mainly of boxes ej5 and of tables. It is
    also visible in the corners of benchmarks/joined_lines.py.
    """

    # Largest distance of ends that meet, or of an end from its corner, px. By hand.
    search_radius_px: float = 15.0
    # Smallest sine of the angle between lines that meet. From the prototype.
    smallest_sine: float = 0.15
    # Standard deviations of the gap between an end and its junction, px, and their prior shares. By
    # hand; the shares are estimated.
    gaps_px: tuple[float, float, float] = (1.0, 3.0, 8.0)
    prior_gaps: tuple[float, float, float] = (0.6, 0.3, 0.1)
    # Prior share of ends at a junction, and number of observations that it counts as in step 2. By
    # hand.
    prior_junction_share: float = 0.5
    prior_observations: int = 5
    # If there are more pairs of near ends, those of the more likely candidates are kept. It limits
    # the memory, about 200 bytes each. By hand.
    max_meetings: int = 1 << 20
    # Smallest share of ends at junctions. Below it, junctions are ignored. From the prototype;
    # shown by the rows "random", which have none.
    min_junction_share: float = 0.1


@dataclass(frozen=True)
class SelectionTuning:
    """Tuned constants of step 2: EM, exclusion of rivals, junctions.

    Their effect is visible in benchmarks/matching.py: rows "1" and "1+2" of the fresh scenes.
    """

    # Two candidates conflict if they share more than this of the shorter part of a segment. From
    # the prototype: a value of 0 helps with cut ends, but fails on tables.
    conflict_overlap: float = 0.3
    # Damping of the messages, from the prototype; largest number of iterations, and change of the
    # log odds at convergence, by hand.
    damping: float = 0.3
    iterations: int = 20
    tolerance: float = 1e-2
    # Rounds of EM, and of junctions. By hand (the prototype used five).
    em_rounds: int = 4
    junction_rounds: int = 4
    # Candidates with lower log odds are discarded: during EM, and after it. By hand (the prototype:
    # -6), for time, because few candidates have few conflicts.
    learn_log_odds: float = -2.0
    prune_log_odds: float = -5.0
    # Largest number of possible conflicts; the most likely candidates are kept. It limits the
    # memory, 40 bytes each. By hand; no scene of 10,000 segments per view reaches it.
    max_conflicts: int = 1 << 22


@dataclass(frozen=True)
class RepetitionTuning:
    """Tuned constants for patterns that repeat along epipolar lines.

    Their effect is visible in benchmarks/repetition.py. They were chosen on its scenes of seeds
    1 to 3, the last constant on seed 1 only. Scenes without patterns (boxes, loose lines and
    blocks, seeds 701 to 703) were used for comparison.
    """

    # Smallest log odds of the candidates that are tested and of their rivals. A candidate is
    # contested if a rival's log odds are less than `contest_log_odds` below its own.
    likely_log_odds: float = 4.0
    contest_log_odds: float = 3.0
    # Number of candidates near a position. With 25, many ordinary scenes seem repeated by chance.
    neighbours: int = 50
    # Share of contested candidates in ordinary scenes and in patterns. Measured medians: 0.0 to
    # 0.1 in ordinary scenes, 0.4 to 0.9 in patterns. Walls before collinear cameras, whose sure
    # tracks were wrong most often, have 0.2 to 0.4. Then the prior log odds of a pattern, small
    # because few lines are little evidence.
    contested_shares: tuple[float, float] = (0.12, 0.4)
    prior_log_odds: float = -3.0
    # Log odds of a track in a pattern: two of seven are right.
    max_log_odds: float = -0.9


@dataclass(frozen=True)
class NoiseTuning:
    """Tuned constants for the estimate of actual over stated errors of segments, from three views.

    Their effect is visible in benchmarks/matching_truth.py: share of lines inside their ellipsoids
    if the stated sigmas are wrong.
    """

    # Smallest posterior of the triples that are used, and number of prior triples with errors as
    # stated. By hand.
    sure_posterior: float = 0.9
    prior_observations: int = 10
    # Segments are used if less than this share of their variance is common to all images. By hand.
    common_share: float = 0.5
    # If errors are larger by more than this factor, the candidates are searched again with the
    # larger errors, because the first gate has cut the tail off. The same if they are much smaller.
    # `passes` is the largest number of passes. By hand; photographs, with their heavy tails, keep
    # the wider gate.
    repeat_above: float = 1.2
    repeat_below: float = 0.2
    passes: int = 6
    # Largest factor of one pass, and of all passes, up or down. By hand.
    max_change: float = 10.0
    max_scale: float = 25.0
    # Prior of the tail of the errors (one over degrees of freedom): shape and mean of a gamma
    # distribution, for segments from images and for others. The first is fitted to rendered seeds 0
    # to 11 and 200 to 205, the second by hand, since simulated errors are normal.
    tail_of_images: tuple[float, float] = (3.0, 0.25)
    tail_otherwise: tuple[float, float] = (1.0, 0.01)
    # Factor, up or down, beyond which a note is written.
    warning_factor: float = 1.5
