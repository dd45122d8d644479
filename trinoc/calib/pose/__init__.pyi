from .estimate import DEGREES as DEGREES
from .estimate import PoseEstimate as PoseEstimate
from .estimate import sheet_pose_of_values as sheet_pose_of_values
from .point_least_squares import PointFit as PointFit
from .point_least_squares import fit_points as fit_points
from .score import score_test as score_test
from .views import fit_views as fit_views
