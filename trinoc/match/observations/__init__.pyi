from .clutter import ClutterModel as ClutterModel, fit_clutter as fit_clutter
from .match_input import (
    MatchInput as MatchInput,
    distorted as distorted,
    prepare as prepare,
    undistorted as undistorted,
)
from .table import (
    PAIRS_IN_BLOCK as PAIRS_IN_BLOCK,
    TRIPLES_IN_BLOCK as TRIPLES_IN_BLOCK,
    SegmentTable as SegmentTable,
    block_of as block_of,
)
