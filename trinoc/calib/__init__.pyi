from .advice.field_difference import FieldDifference as FieldDifference
from .advice.next_shot import NextShot as NextShot
from .batch import calibrate_batch as calibrate_batch
from .bundle.camera import (
    CameraState as CameraState,
    camera_state as camera_state,
    stacked_states as stacked_states,
)
from .bundle.covariance import segment_and_errors as segment_and_errors
from .bundle.factors import d_parameters_d_delta as d_parameters_d_delta
from .bundle.implicit_diff import refined as refined
from .bundle.refinement import refine as refine
from .bundle.result import RefineResult as RefineResult, RefineStatus as RefineStatus
from .detection import (
    Detection as Detection,
    circle_candidates as circle_candidates,
    detect_pattern as detect_pattern,
    detect_target as detect_target,
)
from .from_detections import calibrate_detections as calibrate_detections
from .from_images import calibrate as calibrate
from .from_points import calibrate_points as calibrate_points
from .intrinsics_result import IntrinsicsResult as IntrinsicsResult
from .lens_calibration import calibrate_intrinsics as calibrate_intrinsics
from .result.calibration import CalibrationResult as CalibrationResult, CameraFit as CameraFit
from .result.status import Status as Status
from .rig_calibration import calibrate_rig as calibrate_rig
from .rig_check.comparison import compare_rigs as compare_rigs
from .rig_check.knocked import RigCheck as RigCheck, check_rig as check_rig
from .rig_from_shots import RigFromShots as RigFromShots, next_shot as next_shot
from .systematic_errors import with_systematics as with_systematics
from .targets import (
    BOARDS as BOARDS,
    DICTIONARIES as DICTIONARIES,
    AbstractBoard as AbstractBoard,
    AbstractTarget as AbstractTarget,
    AprilGrid as AprilGrid,
    BoardSet as BoardSet,
    Charuco as Charuco,
    Chessboard as Chessboard,
    Disc as Disc,
    Pattern as Pattern,
    Polygon as Polygon,
    SheetProposal as SheetProposal,
    SquareSheet as SquareSheet,
    board_names as board_names,
    boards_of as boards_of,
    dark_squares as dark_squares,
    marker_cells as marker_cells,
    opencv_board as opencv_board,
    opencv_dictionary as opencv_dictionary,
    printed_sheet as printed_sheet,
    propose_sheet as propose_sheet,
    square_sheet as square_sheet,
)
from .uncertainty.propagation import (
    epipolar_sigma as epipolar_sigma,
    point_covariance as point_covariance,
    projection_sigma as projection_sigma,
)
from .uncertainty.systematics import Systematics as Systematics
