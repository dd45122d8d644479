"""Tuned constants of scouting: what is learned from a sample of the segments of large pictures."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ScoutTuning:
    """Where lines lie, learned before all pairs are tried. Shown by the rows of 2,900 segments per
    view and by the times (benchmarks/matching.py)."""

    # Pictures with more segments than this are scouted, by hand: below, it gains no time.
    above: int = 1500
    # Segments of each view that are matched for it, spread over the picture. By hand.
    sample: int = 300
    # Triples as likely as this say where lines lie; fewer than so many say nothing. By hand.
    sure: float = 0.9
    fewest: int = 60
    # Share of their ends that is left out at either side of the box, the margin about the rest as
    # a share of its side, and the least margin as a share of its longest side. By hand: what lies
    # further out is found by the segments that nothing inside explains.
    left_out: float = 0.0025
    margin: float = 0.16
    thinnest: float = 0.02
    # Candidates are let go that are so much less likely than selection asks, as far as the
    # sample tells. By hand: it learns the parameters anew.
    slack_log_odds: float = 1.5
    # Segments are explained by candidates as likely as this. By hand.
    explained: float = 0.5
    # Only pairs of which an end agrees are tried first, where ends agree: each end may be off by so
    # many of the largest scales of agreement, but for a share of wider ones, and by no more than a
    # share of the usual length of segments. By hand.
    ends_sigmas: float = 3.0
    ends_wider: float = 0.05
    ends_below: float = 0.125
    # Segments are searched again everywhere of which likely candidates show no more than this
    # share. By hand: .9 lost .002 of the triples of random2000_x4, .8 .003 and any part .013 of
    # those of 9,500 segments per view.
    covered: float = 0.95
