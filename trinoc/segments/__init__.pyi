from .find import find_segments as find_segments
from .junctions import find_junctions as find_junctions, with_junctions as with_junctions
from .lsd import find_segments_lsd as find_segments_lsd
from .nevatia_babu.thinning import nevatia_babu_masks as nevatia_babu_masks
from .nothing_found import why_nothing as why_nothing
from .side_intensity import with_side_levels as with_side_levels
from .tuning import SegmentTuning as SegmentTuning
