"""All groups of tuned constants of calibration as one value."""

from dataclasses import dataclass, field

from trinoc.calib.tuning.adjustment import AdjustmentTuning
from trinoc.calib.tuning.advice import AdviceTuning
from trinoc.calib.tuning.answer import AnswerTuning
from trinoc.calib.tuning.bundle import BundleTuning
from trinoc.calib.tuning.detection import DetectionTuning
from trinoc.calib.tuning.photometric import PhotometricTuning
from trinoc.calib.tuning.rig_check import RigCheckTuning
from trinoc.calib.tuning.starts import StartTuning
from trinoc.calib.tuning.targets import TargetTuning
from trinoc.calib.tuning.uncertainty import UncertaintyTuning


@dataclass(frozen=True)
class CalibTuning:
    """All groups; the default is what everything was measured with."""

    targets: TargetTuning = field(default_factory=TargetTuning)
    detection: DetectionTuning = field(default_factory=DetectionTuning)
    photometric: PhotometricTuning = field(default_factory=PhotometricTuning)
    uncertainty: UncertaintyTuning = field(default_factory=UncertaintyTuning)
    starts: StartTuning = field(default_factory=StartTuning)
    advice: AdviceTuning = field(default_factory=AdviceTuning)
    adjustment: AdjustmentTuning = field(default_factory=AdjustmentTuning)
    bundle: BundleTuning = field(default_factory=BundleTuning)
    rig_check: RigCheckTuning = field(default_factory=RigCheckTuning)
    answer: AnswerTuning = field(default_factory=AnswerTuning)


TUNING = CalibTuning()
