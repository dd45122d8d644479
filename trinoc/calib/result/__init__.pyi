from .alternative import Alternative as Alternative
from .calibration import CalibrationResult as CalibrationResult
from .calibration import CameraFit as CameraFit
from .calibration import ImageQuality as ImageQuality
from .status import Status as Status
