"""Tuned constants of shadows."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ShadowTuning:
    """From tracks to shadow boundaries and their lamp. Shown by benchmarks/shadows.py."""

    # Among more lines than these some agree on a lamp by chance, as on photographs of buildings:
    # no lamp is looked for. Measured scenes have half as many. By hand; and what is stated then.
    most_lines: int = 150
    share_unknown: float = 0.06
    # Lines of a plane, at least; a line lies in it within so many sigmas and this share of the
    # median length of lines. Lines less turned than this sine suggest no plane. By hand.
    fewest_in_plane: int = 4
    plane_sigmas: float = 3.0
    flatness: float = 0.015
    least_sine: float = 0.2
    # A line of this sine against a plane leaves it; three lines of this volume of their unit
    # vectors are the corner of a body. By hand.
    leaving_sine: float = 0.25
    body_volume: float = 0.15
    # Levels beside lines are the same within this share; the usual log ratio of both sides.
    level_sigma: float = 0.08
    usual_ratio: float = 0.7
    # Lamps are looked for this high above the plane, middle and to both sides of it, deg: lower
    # ones graze, and one straight above casts a body on its own foot. By hand.
    middle_deg: float = 48.0
    reach_deg: float = 36.0
    # Steps of the coarse search, deg; lamps that are pursued; what counts as another lamp, deg; how
    # sharp the last search is, deg. By hand.
    coarse_deg: float = 4.0
    peaks: int = 10
    apart_deg: float = 8.0
    fine_deg: float = 0.4
    # Lamps are no nearer than this many sizes of the scene, as a reciprocal. By hand.
    nearest: float = 0.1
    # Shares of the scene's size: the error that every line has, what is left of an edge that ends
    # too early, and how far behind its edge a shadow must lie. By hand.
    floor: float = 0.001
    room: float = 0.06
    least_gap: float = 0.05
    # Pairs of lines are coplanar up to this chi-square (1 degree of freedom).
    coplanar_chi_square: float = 9.0
    # Share of shadows whose edge is not among the lines. By hand.
    unexplained: float = 0.25
    # Log odds of a shadow: a constant, then by what `evidence_of_surroundings` counts; with a lamp
    # also by the log likelihood of the edge that casts it. Log odds that the lamp is the true one:
    # a constant, by its score and by its lead over the next. Fitted to 36 rendered scenes of sharp
    # shadows, 12 of soft ones and 6 of none; the last made steeper by hand.
    first_log_odds: tuple[float, ...] = (-2.0, -1.9, -1.4, 1.4, 2.4)
    log_odds_without: tuple[float, ...] = (-2.4, -0.9, -0.6, -0.9, -0.5)
    log_odds_with: tuple[float, ...] = (-1.5, -1.3, -1.6, 1.1, 2.5, 0.75)
    log_odds_of_lamp: tuple[float, ...] = (-10.0, 0.36, 0.06)
    # Added to grey levels before their logarithm is taken: a black level tells little. By hand.
    dark_level: float = 4.0
