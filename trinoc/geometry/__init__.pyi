from .camera import (
    Camera as Camera,
    depth_mm as depth_mm,
    project as project,
    projection_matrix as projection_matrix,
    sheet_from_pixel as sheet_from_pixel,
    viewing_direction as viewing_direction,
)
from .conics import (
    centre_of_mapped_ellipse as centre_of_mapped_ellipse,
    dual_conic_of_circle as dual_conic_of_circle,
    image_of_circle_centre as image_of_circle_centre,
    transform_dual_conic as transform_dual_conic,
)
from .distortion import distort as distort, undistort as undistort
from .epipolar import (
    centre_of_matrix as centre_of_matrix,
    epipolar_distance_px as epipolar_distance_px,
    epipolar_line as epipolar_line,
    fundamental_matrix as fundamental_matrix,
)
from .intrinsics import DISTORTION_MODELS as DISTORTION_MODELS, Intrinsics as Intrinsics
from .junctions import BODY as BODY, Junctions as Junctions
from .line_observations import LineObservations as LineObservations
from .lines import (
    line_of_planes as line_of_planes,
    line_through as line_through,
    plane_of_line as plane_of_line,
    signed_distance as signed_distance,
)
from .pose import PanTiltPose as PanTiltPose, Pose as Pose
from .rig import PARAMETER_NAMES as PARAMETER_NAMES, Rig as Rig
from .rotation import (
    pan_tilt_swing_from_rotation as pan_tilt_swing_from_rotation,
    rotation_from_vector as rotation_from_vector,
)
from .segments import (
    DEFAULT_SIGMA_PX as DEFAULT_SIGMA_PX,
    Segments as Segments,
    covariance_of_ends as covariance_of_ends,
)
from .triangulation import (
    Segment3D as Segment3D,
    triangulate_point as triangulate_point,
    triangulate_segment as triangulate_segment,
)
from .uncertain_lines import (
    UncertainLines as UncertainLines,
    angle_deg as angle_deg,
    distance_mm as distance_mm,
    length_mm as length_mm,
)
