"""All groups of tuned constants of calibration as one value."""

from dataclasses import dataclass, field

from trinoc.calib.tuning.detection import DetectionTuning
from trinoc.calib.tuning.rig_check import RigCheckTuning


@dataclass(frozen=True)
class CalibTuning:
    """All groups; the default is what everything was measured with."""

    detection: DetectionTuning = field(default_factory=DetectionTuning)
    rig_check: RigCheckTuning = field(default_factory=RigCheckTuning)


TUNING = CalibTuning()
