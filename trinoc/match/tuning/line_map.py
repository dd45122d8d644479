"""Tuned constants of the line map and of the wire frame: straight lines, corners, faces."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CollinearTuning:
    """Tuned constants for joining collinear tracks to straight lines.

    Their effect is visible in benchmarks/joined_lines.py: "pairs of tracks joined", and errors of
    lines.
    """

    # Smallest probability that two tracks are one line, or that two ends meet; and smallest
    # probability that both tracks are right.
    min_posterior: float = 0.9
    trusted_posterior: float = 0.7
    # Significance of the tests of joined lines, corners and faces: a larger misfit has this
    # probability.
    significance: float = 1e-3
    # Prior probability that a line has another piece. By hand: with 0.1 to 0.5 the same tracks are
    # joined, except one of 62.
    continuation_share: float = 0.2
    # Half of the pieces were broken by a detector: their gaps have an exponential distribution with
    # this mean, px. Occlusion separates the others, with gaps of any length. By hand.
    break_px: float = 15.0
    # Lines that differ by more sigmas are different lines, and give the density of parallel lines.
    # Lines that differ by less in direction count as parallel, up to the largest angle, degrees.
    # By hand: on rendered scenes (seeds 18 to 20) 24 of 72 pairs are joined wrongly, with 40
    # degrees 31 of 79.
    gate_sigmas: float = 5.0
    max_angle_deg: float = 20.0
    # Factors of the stated errors of segments, and their shares. Fitted to the segments of 18
    # rendered scenes (seeds 0 to 11 and 200 to 205). No factor is below 1, so that no covariance is
    # smaller than the segments' own. The shares are those of tracks with the tail `error_tail`
    # (`Matches.noise_tail`). Those of larger errors grow with the tail, up to the largest factor.
    # Both are from seeds 0 to 11 and 200 to 205.
    error_scales: tuple[float, float, float] = (1.0, 2.0, 5.0)
    error_shares: tuple[float, float, float] = (0.84, 0.12, 0.04)
    error_tail: float = 0.1
    max_share_factor: float = 2.5


@dataclass(frozen=True)
class CornerTuning:
    """Tuned constants for moving line ends to corners, besides `JunctionTuning` and
    `CollinearTuning`.

    Their effect is visible in benchmarks/joined_lines.py: corners and lengths.
    """

    # Standard deviation along its line of the end of a segment, px. By hand; the median error of
    # free ends is 6.9 px (docs/segments.md).
    free_end_px: float = 7.0


@dataclass(frozen=True)
class WireframeTuning:
    """Tuned constants of the faces of the wire frame. The constants of the vertices are in
    `CornerTuning`.

    Their effect is visible in benchmarks/wireframe.py.
    """

    # Largest sigma of a face's vertices across it, as a share of its size. By hand.
    max_plane_sigma_share: float = 0.1
