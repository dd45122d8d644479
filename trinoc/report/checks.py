"""What a check of a report is: a question, how it is answered, and what is called bad."""

import enum
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from trinoc.calib.result.calibration import CalibrationResult
from trinoc.match.tracks.matches import Matches
from trinoc.report.coverage import Coverage, MeanResiduals
from trinoc.report.epipolar_part import EpipolarPart
from trinoc.report.field_part import FieldPart, Uncertainty
from trinoc.report.frames_part import FramesPart


class Level(enum.Enum):
    """How a check came out, the worst first; the value is what the page says."""

    BAD = "bad"
    CARE = "take care"
    JUDGE = "for you to judge"
    GOOD = "good"


class Subject(NamedTuple):
    """What there is to judge; a check answers None where what it asks for is not there."""

    result: CalibrationResult | None = None
    shots: CalibrationResult | None = None
    matches: Matches | None = None
    doubts: Mapping[str, str] = {}
    coverage: Sequence[Coverage] = ()
    residuals: Sequence[MeanResiduals] = ()
    epipolar: Sequence[EpipolarPart] = ()
    field: FieldPart | None = None
    uncertainty: Uncertainty | None = None
    recording: FramesPart | None = None


class Answer(NamedTuple):
    """The number that is held against the limits, and the same in a figure and in words.

    part : the part of the page to look at, where it is not that of the check.
    remedy : what to do, where it is not that of the check.
    """

    value: float
    figure: str
    words: str
    part: str = ""
    remedy: str = ""


class ReportCheck(NamedTuple):
    """One question, its answer in a figure and in words, and what to do where it is not good."""

    question: str
    level: Level
    figure: str
    words: str
    remedy: str
    part: str


class Limits(NamedTuple):
    """A row of the table: what is asked, how it is answered, and what is called bad.

    Fields
    ------
    good : the largest value that is good, or, where `at_least`, the smallest; None where the
        reader judges.
    beyond : what a value is that is not good; one above `bad`, or not a number, is bad.
    """

    question: str
    part: str
    good: float | None
    remedy: str
    answer: Callable[[Subject], Answer | None]
    beyond: Level = Level.CARE
    bad: float = np.inf
    at_least: bool = False

    def check(self, subject: Subject) -> ReportCheck | None:
        """The check, or None where nothing answers it."""
        answer = self.answer(subject)
        if answer is None:
            return None
        level = self._level(answer.value)
        remedy = "" if level is Level.GOOD else answer.remedy or self.remedy
        part = answer.part or self.part
        return ReportCheck(self.question, level, answer.figure, answer.words, remedy, part)

    def _level(self, value: float) -> Level:
        if self.good is None:
            return Level.JUDGE
        if value >= self.good if self.at_least else value <= self.good:
            return Level.GOOD
        return self.beyond if value <= self.bad else Level.BAD
