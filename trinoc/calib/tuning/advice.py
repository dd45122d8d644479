"""Tuned constants of the advice on what to show next."""

from dataclasses import dataclass


@dataclass(frozen=True)
class AdviceTuning:
    """Shots that are foreseen, and where two halves of the shots are compared. By hand."""

    # Points are compared where the boards were, and so many times as far, where errors of lens and
    # pose no longer cancel.
    farther: float = 3.0
    # How the board may be held: tilted by so many degrees, with so large a share of the picture's
    # shorter side, and with such a share left around it where it is held aside.
    tilt_deg: float = 40.0
    fills: tuple[float, ...] = (0.35, 0.6)
    margin: float = 0.05
    # A board that is seen in part tells by so large a share of its places (a chessboard by all),
    # and by none that is seen farther from its normal.
    least_seen: float = 0.6
    most_oblique_deg: float = 65.0
    # So many shots are compared: those of which the rig tells least.
    most_compared: int = 40
    # What the pictures do not determine is taken to be known to so many of its steps beforehand,
    # so that advice is possible; no covariance that leaves the room contains it.
    prior_sigma: float = 3.0
