"""Tuned constants of what is said of a calibration: the files of `calib` itself, and `result`."""

from dataclasses import dataclass


@dataclass(frozen=True)
class AnswerTuning:
    """Which answer is given, and what a message says of it."""

    # Where noise alone makes so much with less than this probability, the residuals speak against
    # what a model holds fixed, and pictures against a held aim. By hand.
    chance: float = 1e-4
