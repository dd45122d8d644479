"""Tuned constants of the line map: straight lines, corners, faces."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CollinearTuning:
    """Tracks joined to straight lines. Shown by "pairs of tracks joined" and by the errors of lines
    of benchmarks/joined_lines.py."""

    # Tracks are joined, and ends meet, where that is as likely as this; of tracks both are right as
    # likely as that.
    min_posterior: float = 0.9
    trusted_posterior: float = 0.7
    # A line that fits its segments as badly as this share of true lines does is none, nor a corner
    # that fits its lines so, nor a face its vertices.
    significance: float = 1e-3
    # How often a line has another piece. By hand: at .1 to .5 the same are joined, but one of 62.
    share: float = 0.2
    # Of half of the pieces, which a detector broke, gaps are spread exponentially with this mean,
    # px; the rest is hidden by something, with gaps of any length. By hand.
    break_px: float = 15.0
    # Lines further apart than so many sigmas are surely others, stay apart, and tell how dense
    # parallel lines are; those within as many in direction count as parallel, but not beyond the
    # widest, degrees. By hand: on rendered scenes (seeds 18 to 20) 24 of 72 pairs are joined
    # wrongly, at 40 degrees 31 of 79.
    gate_sigmas: float = 5.0
    widest_deg: float = 20.0
    # Segments err by more than they say: by one of these factors, in so many cases. Fitted to the
    # segments of 18 rendered scenes (seeds 0 to 11 and 200 to 205). Smaller errors are not assumed,
    # so that no covariance is smaller than the segments' own. The shares of larger errors are those
    # of tracks with this tail (`Matches.noise_tail`), and grow with it, at most so many times: both
    # from seeds 0 to 11 and 200 to 205.
    error_scales: tuple[float, float, float] = (1.0, 2.0, 5.0)
    error_shares: tuple[float, float, float] = (0.84, 0.12, 0.04)
    error_tail: float = 0.1
    most_error_shares: float = 2.5


@dataclass(frozen=True)
class CornerTuning:
    """Ends snapped to corners, with `JunctionTuning` and `CollinearTuning`. Shown by the corners
    and the lengths of benchmarks/joined_lines.py."""

    # Standard deviation along its line of where a detector stops, px. By hand; free ends are 6.9 px
    # off in the median (docs/segments.md).
    free_end_px: float = 7.0


@dataclass(frozen=True)
class WireframeTuning:
    """Faces of the wire frame, with `CornerTuning` for what fits its corner. Shown by
    benchmarks/wireframe.py."""

    # A loop is a face where its vertices are known across it to this share of its size. By hand.
    plane_doubt: float = 0.1
