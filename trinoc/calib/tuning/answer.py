"""Tuned constants of what is answered and said: the files of `calib` itself, and `result`."""

from dataclasses import dataclass


@dataclass(frozen=True)
class AnswerTuning:
    """Which answer is given, and what a message says of it. By hand where nothing else is said;
    shown by benchmarks/picture_conditions.py and benchmarks/rigs_held_out.py."""

    # Where noise makes so much with less than this probability, pictures speak against what a model
    # holds fixed, and against an aim.
    chance: float = 1e-4
    # The same of a score test that calls for more coefficients of a lens.
    chance_of_lens: float = 1e-3
    # The same of two answers of a picture, by circles and by grey levels, that differ so much: one
    # right picture in a hundred pays with a third of its sigmas.
    chance_of_answers: float = 1e-2
    # Blocks of right circles scatter so many times as much as claimed once in hundreds of pictures.
    largest_scatter: float = 1.5
    # Shifts of places by less, px, do not bend an edge's profile: pictures say nothing new.
    least_shift_px: float = 0.02
    # Ink that spreads less, mm, moves the centres of circles by less than they are known to.
    least_spread_mm: float = 0.01
    # A lens is worse where its errors on held-out shots are larger by so many standard deviations;
    # none counts beyond so many times the best lens's median.
    worse_sigmas: float = 2.0
    cap: float = 5.0
    # Fewer points do not tell a lens.
    fewest_points: int = 8
    # Root mean square misfits beyond this share of what the sheet takes of the picture, and of a
    # board whose lens is fitted, are of another model; they are at least so many px.
    misfit_share: float = 0.01
    misfit_share_of_lens: float = 0.003
    least_misfit_px: float = 1.0
    # Beyond this, a reduced chi-square is told; and a share of pixels that were left out.
    large_chi_square: float = 2.0
    cut_share: float = 0.01
    # Sheet, board or lens is another than was said beyond so many of the stated sigmas.
    strain_sigmas: float = 4.0
    # A distortion is held by places that reach this share of the way to the corners.
    enough_reach: float = 0.8
