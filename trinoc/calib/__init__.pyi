from .batch import calibrate_batch as calibrate_batch
from .bundle.covariance import segment_and_errors as segment_and_errors
from .bundle.factors import d_parameters_d_delta as d_parameters_d_delta
from .bundle.implicit_diff import refined as refined
from .bundle.refinement import refine as refine
from .bundle.result import RefineResult as RefineResult, RefineStatus as RefineStatus
from .detection.any_target import detect_target as detect_target
from .detection.detection import Detection as Detection
from .detection.search import (
    circle_candidates as circle_candidates,
    detect_pattern as detect_pattern,
)
from .from_detections import calibrate_detections as calibrate_detections
from .from_images import calibrate as calibrate
from .from_points import calibrate_points as calibrate_points
from .intrinsics.result import IntrinsicsResult as IntrinsicsResult
from .lens_from_images import calibrate_intrinsics as calibrate_intrinsics
from .model.camera import (
    CameraState as CameraState,
    camera_state as camera_state,
    stacked_states as stacked_states,
)
from .pose.least_squares import fit_circles as fit_circles
from .result.calibration import CalibrationResult as CalibrationResult, CameraFit as CameraFit
from .result.status import Status as Status
from .rig_check.comparison import compare_rigs as compare_rigs
from .rig_check.knocked import RigCheck as RigCheck, check_rig as check_rig
from .shots.advised_shot import NextShot as NextShot, next_shot as next_shot
from .shots.field_difference import FieldDifference as FieldDifference
from .shots.from_shots import calibrate_rig as calibrate_rig
from .shots.projection import projection_sigma as projection_sigma
from .shots.result import RigFromShots as RigFromShots
from .targets.abstract_target import AbstractTarget as AbstractTarget
from .targets.april_grid import AprilGrid as AprilGrid
from .targets.board_set import (
    BoardSet as BoardSet,
    board_names as board_names,
    boards_of as boards_of,
)
from .targets.checkers import (
    DICTIONARIES as DICTIONARIES,
    Charuco as Charuco,
    Chessboard as Chessboard,
    dark_squares as dark_squares,
)
from .targets.markers import (
    charuco_markers as charuco_markers,
    marker_cells as marker_cells,
    opencv_board as opencv_board,
    opencv_dictionary as opencv_dictionary,
)
from .targets.pattern import Pattern as Pattern
from .targets.print_scale import printed_sheet as printed_sheet
from .targets.proposal import SheetProposal as SheetProposal, propose_sheet as propose_sheet
from .targets.squares import SquareSheet as SquareSheet, square_sheet as square_sheet
from .uncertainty.propagation import (
    epipolar_sigma as epipolar_sigma,
    point_covariance as point_covariance,
)
from .uncertainty.systematics import (
    Systematics as Systematics,
    with_systematics as with_systematics,
)
