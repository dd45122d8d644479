from .advice.next_shot import (
    next_shot as next_shot,
)
from .bundle.implicit_diff import (
    refine_differentiably as refine_differentiably,
)
from .bundle.result import (
    RefineResult as RefineResult,
)
from .detection.detection import (
    Detection as Detection,
)
from .detection.registry import (
    detect_pattern as detect_pattern,
    detect_target as detect_target,
)
from .from_detections import (
    calibrate_detections as calibrate_detections,
)
from .result.calibration import (
    CalibrationResult as CalibrationResult,
    CameraFit as CameraFit,
    Status as Status,
)
from .rig_check.knocked import (
    RigCheck as RigCheck,
)
from .systematic_errors import (
    with_systematics as with_systematics,
)
from .targets.board_set import (
    BoardSet as BoardSet,
)
from .targets.printing import (
    printed_sheet as printed_sheet,
)
from .tuning.every_group import (
    CalibTuning as CalibTuning,
)
from .uncertainty.propagation import (
    epipolar_sigma as epipolar_sigma,
    point_covariance as point_covariance,
    projection_sigma as projection_sigma,
)
