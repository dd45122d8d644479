from . import errors as errors
from .batch import load_recording as load_recording, match_recording as match_recording
from .calib import (
    AprilGrid as AprilGrid,
    BoardSet as BoardSet,
    Charuco as Charuco,
    Chessboard as Chessboard,
    Pattern as Pattern,
    Systematics as Systematics,
    calibrate as calibrate,
    calibrate_intrinsics as calibrate_intrinsics,
    calibrate_points as calibrate_points,
    calibrate_rig as calibrate_rig,
    check_rig as check_rig,
    detect_pattern as detect_pattern,
    detect_target as detect_target,
    epipolar_sigma as epipolar_sigma,
    next_shot as next_shot,
    point_covariance as point_covariance,
    projection_sigma as projection_sigma,
    refine as refine,
    with_systematics as with_systematics,
)
from .evaluation import evaluate as evaluate
from .geometry import Camera as Camera, Intrinsics as Intrinsics, Rig as Rig, Segments as Segments
from .io import (
    enable_compile_cache as enable_compile_cache,
    load as load,
    load_matches as load_matches,
    load_pattern as load_pattern,
    load_rig as load_rig,
    load_segments as load_segments,
    load_shape as load_shape,
    load_shots as load_shots,
    load_target as load_target,
    save as save,
)
from .match import (
    Corners as Corners,
    Cylinders as Cylinders,
    GuidedMatches as GuidedMatches,
    JoinedLines as JoinedLines,
    Matches as Matches,
    MatchesWithRims as MatchesWithRims,
    Rims as Rims,
    Shadows as Shadows,
    Wireframe as Wireframe,
    add_rims as add_rims,
    find_cylinders as find_cylinders,
    find_rims as find_rims,
    find_shadows as find_shadows,
    guide_matches as guide_matches,
    join_collinear as join_collinear,
    match_many as match_many,
    match_segments as match_segments,
    measure_lines as measure_lines,
    snap_corners as snap_corners,
    warm_up as warm_up,
    wireframe as wireframe,
)
from .segments import (
    find_segments as find_segments,
    find_segments_lsd as find_segments_lsd,
    with_side_levels as with_side_levels,
)

__all__: list[str]
__version__: str
