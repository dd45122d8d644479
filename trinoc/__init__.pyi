from . import calib as calib, errors as errors, io as io, match as match, segments as segments
from .batch import load_recording as load_recording, match_recording as match_recording
from .calib import (
    AprilGrid as AprilGrid,
    Charuco as Charuco,
    Chessboard as Chessboard,
    Pattern as Pattern,
    Systematics as Systematics,
    calibrate as calibrate,
    calibrate_intrinsics as calibrate_intrinsics,
    calibrate_points as calibrate_points,
    calibrate_rig as calibrate_rig,
    check_rig as check_rig,
    next_shot as next_shot,
    refine as refine,
)
from .evaluation import evaluate as evaluate
from .geometry import Camera as Camera, Intrinsics as Intrinsics, Rig as Rig, Segments as Segments
from .io import (
    load as load,
    load_matches as load_matches,
    load_pattern as load_pattern,
    load_rig as load_rig,
    load_segments as load_segments,
    save as save,
)
from .match import (
    Matches as Matches,
    match_segments as match_segments,
)
from .segments import (
    find_segments as find_segments,
)

__all__: list[str]
__version__: str
