from .evaluation import (
    Evaluation as Evaluation,
    EvaluationStatus as EvaluationStatus,
    evaluate as evaluate,
)
from .known_shape import GREY_STEP as GREY_STEP, KnownShape as KnownShape
from .scoring import LengthScore as LengthScore, score_lengths as score_lengths
from .sweep import (
    Row as Row,
    SweepSetting as SweepSetting,
    evaluate_matches as evaluate_matches,
    evaluate_settings as evaluate_settings,
    settings_of as settings_of,
)
from .wire_frames import WireframeScore as WireframeScore
