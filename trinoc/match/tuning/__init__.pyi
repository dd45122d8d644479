from .candidates import CandidateTuning as CandidateTuning, ScoutTuning as ScoutTuning
from .cylinders import CylinderTuning as CylinderTuning
from .every_group import DEFAULT as DEFAULT, MatchTuning as MatchTuning
from .evidence import (
    ClutterTuning as ClutterTuning,
    EndTuning as EndTuning,
    EvidenceTuning as EvidenceTuning,
    SideTuning as SideTuning,
)
from .guided import GuidedTuning as GuidedTuning
from .line_map import (
    CollinearTuning as CollinearTuning,
    CornerTuning as CornerTuning,
    DepthTuning as DepthTuning,
    WireframeTuning as WireframeTuning,
)
from .occlusion import OcclusionTuning as OcclusionTuning
from .rims import RimTuning as RimTuning
from .selection import (
    JunctionTuning as JunctionTuning,
    NoiseTuning as NoiseTuning,
    SelectionTuning as SelectionTuning,
)
from .shadows import ShadowTuning as ShadowTuning
from .tracks import TrackTuning as TrackTuning
