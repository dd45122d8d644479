"""Tuned constants of the starts of a fit."""

from dataclasses import dataclass


@dataclass(frozen=True)
class StartTuning:
    """First lenses, and cameras and boards chained into one frame. By hand; shown by the shots
    that are refused, and by lenses that are found, in benchmarks/rigs_from_shots.py."""

    # Focal lengths to start from, in longer sides of the picture: where Zhang's formula has none,
    # and of a fisheye.
    focal_shares: tuple[float, ...] = (0.7, 1.4, 3.0, 8.0)
    fisheye_shares: tuple[float, ...] = (0.2, 0.25, 0.3, 0.36, 0.45, 0.55, 0.7, 1.0, 1.4)
    # A place that lies farther off its picture's homography, as a share of the board's extent
    # there, was located wrongly: lenses bend less.
    gross_share: float = 0.05
    # A board that lies farther off, as such a share, stands elsewhere: first lenses are a few
    # percent off. Either is at least so many pixels.
    elsewhere_share: float = 0.06
    least_px: float = 3.0
    # Turns about one axis leave open how far cameras lie along it: those about others have at least
    # this share of them.
    least_other_turns: float = 0.05
    # Boards whose planes differ by less look parallel: focal length and distance look alike then.
    parallel_deg: float = 8.0
    # Cameras whose pictures were counted differently are tried so many shots apart.
    most_shift: int = 3
