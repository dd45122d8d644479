"""A check of the report: its question, the function that answers it, and its limits."""

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
    """Outcome of a check, from the worst to the best. The value is the text on the page."""

    BAD = "bad"
    CARE = "take care"
    JUDGE = "for you to judge"
    GOOD = "good"


class Subject(NamedTuple):
    """Contents of a report that its checks read.

    Contents that the report does not have are None or empty, and their checks are omitted.
    """

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
    """Result of a check before it is compared with limits.

    Attributes
    ----------
    value : float
        Number that is compared with the limits.
    figure : str
        That number as text, with its unit.
    explanation : str
        Sentence that says what the number is.
    part : str
        Anchor of the section to look at; "" for the section of the check's row in the table.
    remedy : str
        What to do; "" for the remedy of the check's row in the table.
    """

    value: float
    figure: str
    explanation: str
    part: str = ""
    remedy: str = ""


class ReportCheck(NamedTuple):
    """Result of a check, as the report shows it.

    Attributes
    ----------
    question : str
        Question that the check answers.
    level : Level
        Outcome.
    figure : str
        Deciding number as text.
    explanation : str
        Sentence that says what the number is.
    remedy : str
        What to do; "" if the outcome is good.
    part : str
        Anchor of the section to look at.
    """

    question: str
    level: Level
    figure: str
    explanation: str
    remedy: str
    part: str


class Limits(NamedTuple):
    """Row of the table of checks.

    Attributes
    ----------
    question : str
        Question that the check answers.
    part : str
        Anchor of the section to look at.
    good : float or None
        Largest good value, or with `at_least` the smallest; None if the reader has to decide.
    remedy : str
        What to do if the value is not good.
    answer : callable
        Function that computes the `Answer` for a report, or None if the report lacks the contents.
    beyond : Level
        Outcome of a value that is not good.
    bad : float
        Value above which the outcome is bad instead of `beyond`. NaN is also bad.
    at_least : bool
        True if large values are good.
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
        """Carry out the check on a report; None if the report lacks the contents."""
        answer = self.answer(subject)
        if answer is None:
            return None
        level = self._level(answer.value)
        remedy = "" if level is Level.GOOD else answer.remedy or self.remedy
        section = answer.part or self.part
        return ReportCheck(self.question, level, answer.figure, answer.explanation, remedy, section)

    def _level(self, value: float) -> Level:
        if self.good is None:
            return Level.JUDGE
        if value >= self.good if self.at_least else value <= self.good:
            return Level.GOOD
        return self.beyond if value <= self.bad else Level.BAD
