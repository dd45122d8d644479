from .clutter import ClutterModel as ClutterModel, fit_clutter as fit_clutter
from .common_view import (
    look_apart as look_apart,
    mirrored_error as mirrored_error,
    turned_round as turned_round,
)
from .match_input import (
    CamerasInput as CamerasInput,
    FrameInput as FrameInput,
    MatchInput as MatchInput,
    cameras_of as cameras_of,
    prepare as prepare,
    prepare_frame as prepare_frame,
    stacked_frames as stacked_frames,
    with_noise_scale as with_noise_scale,
)
from .pictures_of_views import (
    as_segments as as_segments,
    check_pictures as check_pictures,
    segments_of_views as segments_of_views,
)
from .side_intensity import SIDE_COLUMNS as SIDE_COLUMNS
from .table import (
    PAIRS_IN_BLOCK as PAIRS_IN_BLOCK,
    TRIPLES_IN_BLOCK as TRIPLES_IN_BLOCK,
    SegmentTable as SegmentTable,
    block_of as block_of,
    frames_of as frames_of,
    matrices_of as matrices_of,
    segments_per_view as segments_per_view,
)
