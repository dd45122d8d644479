from .batch import (
    match_many as match_many,
)
from .line_map.collinear_merge import (
    join_collinear as join_collinear,
)
from .line_map.corners import (
    Corners as Corners,
    snap_corners as snap_corners,
)
from .pixels.measure import (
    measure_lines as measure_lines,
)
from .pixels.tuning import (
    PixelTuning as PixelTuning,
)
from .rims.explained_tracks import (
    add_rims as add_rims,
)
from .rims.rim_search import (
    find_rims as find_rims,
)
from .rims.rims import (
    Rims as Rims,
)
from .steps import (
    improve as improve,
)
from .tuning.every_group import (
    MatchTuning as MatchTuning,
)
from .wire_frame.build import (
    wireframe as wireframe,
)
from .wire_frame.depth import (
    depth_map as depth_map,
)
from .wire_frame.frame import (
    Wireframe as Wireframe,
)
