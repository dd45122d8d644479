from .batch import MatchBatch as MatchBatch, match_many as match_many
from .bodies import (
    Cylinders as Cylinders,
    MatchesWithRims as MatchesWithRims,
    Rims as Rims,
    Shadows as Shadows,
    add_rims as add_rims,
    find_cylinders as find_cylinders,
    find_rims as find_rims,
    find_shadows as find_shadows,
)
from .candidates.triples import trinocular_candidates as trinocular_candidates
from .features import FEATURES as FEATURES
from .line_map.collinear_merge import join_collinear as join_collinear
from .line_map.corners import Corners as Corners, snap_corners as snap_corners
from .line_map.depth import depth_map as depth_map
from .line_map.lines import JoinedLines as JoinedLines
from .matcher import match_segments as match_segments
from .observations.clutter import fit_clutter as fit_clutter
from .observations.match_input import MatchInput as MatchInput, prepare as prepare
from .occlusion.pairs import occluded_pairs as occluded_pairs
from .pixels import (
    GuidedMatches as GuidedMatches,
    PixelTuning as PixelTuning,
    guide_matches as guide_matches,
    measure_lines as measure_lines,
)
from .selection.marginals import Selection as Selection, select as select
from .step_names import StepName as StepName
from .steps import STEPS as STEPS, Found as Found, Step as Step, improve as improve
from .tracks.matches import (
    BINOCULAR as BINOCULAR,
    EVEN as EVEN,
    TRINOCULAR as TRINOCULAR,
    Matches as Matches,
)
from .tuning import MatchTuning as MatchTuning
from .warming import warm_up as warm_up
from .wire_frame import LetGo as LetGo, Wireframe as Wireframe, wireframe as wireframe
