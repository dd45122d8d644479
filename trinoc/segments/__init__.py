"""Step 0 of the method: from one image to line segments.

`find_segments` is the detector of Nevatia and Babu (1980), with sub-pixel lines and covariance.
`find_segments_lsd` is OpenCV's detector, corrected for its bias. `find_junctions` computes the
points where segments meet, `with_side_levels` the grey levels on both sides. Segments of any other
detector are an (n, 4) array and need nothing from this room.
"""

from trinoc.segments.find import (
    find_segments as find_segments,
)
from trinoc.segments.junctions import (
    find_junctions as find_junctions,
    with_junctions as with_junctions,
)
from trinoc.segments.lsd import (
    find_segments_lsd as find_segments_lsd,
)
from trinoc.segments.nevatia_babu.masks import nevatia_babu_masks as nevatia_babu_masks
from trinoc.segments.nothing_found import (
    why_nothing as why_nothing,
)
from trinoc.segments.side_intensity import (
    with_side_levels as with_side_levels,
)
from trinoc.segments.tuning import (
    SegmentTuning as SegmentTuning,
)
