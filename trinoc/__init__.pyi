from . import calib as calib, errors as errors, io as io, match as match, segments as segments
from .batch.run import match_recording as match_recording
from .calib.advice.next_shot import next_shot as next_shot
from .calib.bundle.refinement import refine as refine
from .calib.from_points import calibrate_points as calibrate_points
from .calib.lens_calibration import calibrate_intrinsics as calibrate_intrinsics
from .calib.rig_calibration import calibrate_rig as calibrate_rig
from .calib.rig_check.knocked import check_rig as check_rig
from .calib.sheet_calibration import calibrate as calibrate
from .calib.targets.april_grid import AprilGrid as AprilGrid
from .calib.targets.checkers import Charuco as Charuco, Chessboard as Chessboard
from .calib.targets.pattern import Pattern as Pattern
from .calib.uncertainty.systematics import Systematics as Systematics
from .evaluation.evaluation import evaluate as evaluate
from .evaluation.lines_of_rig import with_rig_covariance as with_rig_covariance
from .geometry.camera import Camera as Camera
from .geometry.intrinsics import Intrinsics as Intrinsics
from .geometry.rig import Rig as Rig
from .geometry.segments import Segments as Segments
from .image.ideal_pictures import rectify as rectify, undistort as undistort
from .io.board_json import load_pattern as load_pattern
from .io.frames_files import load_recording as load_recording
from .io.rig_json import load_rig as load_rig
from .io.saving import load as load, load_matches as load_matches, save as save
from .io.segment_table import load_segments as load_segments
from .match.matcher import match_segments as match_segments
from .match.tracks.matches import Matches as Matches
from .segments.find import find_segments as find_segments

__all__: list[str]
__version__: str
