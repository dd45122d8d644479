"""Tuned constants of the one calibration problem."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ProblemTuning:
    """What noise makes and what not: of a place, a picture, a camera's sigmas, the board. Shown by
    errors and coverage of benchmarks/rigs_from_shots.py and benchmarks/calibration.py."""

    # A place farther off, in robust standard deviations, was located wrongly: noise makes it once
    # in 10^8. By hand.
    gate: float = 6.0
    # Scales, in robust standard deviations, at which the influence of a place is bounded from round
    # to round. By hand.
    annealing: tuple[float, ...] = (30.0, 10.0, 5.0)
    # A picture of which a smaller share of places agrees shows the board elsewhere. By hand.
    fewest_agree: float = 0.5
    # A chi-square so many of its own standard deviations above its degrees of freedom is not noise:
    # sigmas grow, or a board's places are free. By hand.
    refuted_sigmas: float = 4.0
    # The same of the pulls of whole shots. By hand.
    shots_sigmas: float = 3.0
    # The first guess of how far a board's places lie off, over what is left of the fit. By hand.
    first_spread: float = 3.0
    # Heights of second, third and fourth degree of a sheet against its flatness: paper that was
    # rolled changes its curvature by a part of it. By hand.
    height_shares: tuple[float, float, float] = (1.0, 0.5, 0.25)
