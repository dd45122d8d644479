from .evaluation import (
    Evaluation as Evaluation,
    EvaluationStatus as EvaluationStatus,
    evaluate as evaluate,
)
from .known_shape import GREY_STEP as GREY_STEP, KnownShape as KnownShape
from .scoring import (
    LengthScore as LengthScore,
    MatchScore as MatchScore,
    score_groups as score_groups,
    score_lengths as score_lengths,
    score_matches as score_matches,
)
from .sweep import (
    Row as Row,
    SweepSetting as SweepSetting,
    evaluate_matches as evaluate_matches,
    evaluate_settings as evaluate_settings,
    settings_of as settings_of,
)
from .wire_frames import WireframeScore as WireframeScore
