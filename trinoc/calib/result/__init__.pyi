from .alternative import Alternative as Alternative
from .calibration import (
    CalibrationResult as CalibrationResult,
    CameraFit as CameraFit,
    ImageQuality as ImageQuality,
)
from .status import Status as Status
