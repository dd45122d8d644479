"""All groups of tuned constants as one value."""

from dataclasses import dataclass, field

from trinoc.match.tuning.candidates import CandidateTuning, ScoutTuning
from trinoc.match.tuning.evidence import (
    ClutterTuning,
    EndTuning,
    EvidenceTuning,
    ObservationTuning,
    SideTuning,
)
from trinoc.match.tuning.line_map import (
    CollinearTuning,
    CornerTuning,
    WireframeTuning,
)
from trinoc.match.tuning.occlusion import OcclusionTuning
from trinoc.match.tuning.rims import RimTuning
from trinoc.match.tuning.selection import (
    JunctionTuning,
    NoiseTuning,
    RepetitionTuning,
    SelectionTuning,
)
from trinoc.match.tuning.tracks import DecoyTuning, TrackTuning, ViewSupportTuning


@dataclass(frozen=True)
class MatchTuning:
    """All tuned constants of the matcher, in groups.

    All published figures were measured with the default values.
    """

    observations: ObservationTuning = field(default_factory=ObservationTuning)
    clutter: ClutterTuning = field(default_factory=ClutterTuning)
    sides: SideTuning = field(default_factory=SideTuning)
    candidates: CandidateTuning = field(default_factory=CandidateTuning)
    scouting: ScoutTuning = field(default_factory=ScoutTuning)
    ends: EndTuning = field(default_factory=EndTuning)
    evidence: EvidenceTuning = field(default_factory=EvidenceTuning)
    junctions: JunctionTuning = field(default_factory=JunctionTuning)
    selection: SelectionTuning = field(default_factory=SelectionTuning)
    repetition: RepetitionTuning = field(default_factory=RepetitionTuning)
    noise: NoiseTuning = field(default_factory=NoiseTuning)
    occlusion: OcclusionTuning = field(default_factory=OcclusionTuning)
    tracks: TrackTuning = field(default_factory=TrackTuning)
    view_support: ViewSupportTuning = field(default_factory=ViewSupportTuning)
    decoys: DecoyTuning = field(default_factory=DecoyTuning)
    collinear: CollinearTuning = field(default_factory=CollinearTuning)
    corners: CornerTuning = field(default_factory=CornerTuning)
    wireframe: WireframeTuning = field(default_factory=WireframeTuning)
    rims: RimTuning = field(default_factory=RimTuning)


DEFAULT = MatchTuning()
