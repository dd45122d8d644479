from .camera import (
    Camera as Camera,
    depth_mm as depth_mm,
    project as project,
    projection_matrix as projection_matrix,
    sheet_from_pixel as sheet_from_pixel,
    viewing_direction as viewing_direction,
)
from .epipolar import (
    centre_of_matrix as centre_of_matrix,
    epipolar_distance_px as epipolar_distance_px,
    epipolar_line as epipolar_line,
    fundamental_matrix as fundamental_matrix,
)
from .features import Feature as Feature, Wires as Wires, wires_of_lines as wires_of_lines
from .image_of_circle import (
    circle_centre_offset as circle_centre_offset,
    image_of_circle_centre as image_of_circle_centre,
)
from .intrinsics import (
    Intrinsics as Intrinsics,
    distort_pixels as distort_pixels,
    undistort_pixels as undistort_pixels,
)
from .lenses.abstract_lens import (
    AFFINE_PARAMETERS as AFFINE_PARAMETERS,
    AbstractLens as AbstractLens,
    ray_of_normalised as ray_of_normalised,
)
from .lenses.brown_conrady import BrownConrady as BrownConrady
from .lenses.kannala_brandt import KannalaBrandt as KannalaBrandt
from .lenses.rational import Rational as Rational, ThinPrism as ThinPrism
from .lenses.registry import (
    DEFAULT_DISTORTION as DEFAULT_DISTORTION,
    LENS_MODELS as LENS_MODELS,
    lens_model as lens_model,
    promoted as promoted,
    simplified as simplified,
    splined as splined,
    stack_lenses as stack_lenses,
)
from .lenses.splined import (
    SPLINE_PARAMETERS as SPLINE_PARAMETERS,
    SPLINED as SPLINED,
    AbstractSplined as AbstractSplined,
    SplinedBrownConrady as SplinedBrownConrady,
    SplinedKannalaBrandt as SplinedKannalaBrandt,
    SplinedRational as SplinedRational,
)
from .line_lengths import LineSigmas as LineSigmas, line_sigmas as line_sigmas
from .lines import (
    line_of_planes as line_of_planes,
    line_through as line_through,
    plane_of_line as plane_of_line,
    signed_distance as signed_distance,
)
from .pose import (
    Pose as Pose,
    PoseModel as PoseModel,
    pose_model_over_sheet as pose_model_over_sheet,
)
from .projection import (
    LineDistances as LineDistances,
    Projection as Projection,
    distances_from_line as distances_from_line,
    homogeneous_pixel as homogeneous_pixel,
    image_of_point as image_of_point,
    pixel_change as pixel_change,
    project_by_matrix as project_by_matrix,
    project_point as project_point,
    project_points as project_points,
    project_with_jacobian as project_with_jacobian,
    unproject_pixels as unproject_pixels,
)
from .rig import (
    PARAMETER_NAMES as PARAMETER_NAMES,
    Rig as Rig,
    at_one_place as at_one_place,
)
from .rotation import rotation_from_vector as rotation_from_vector
from .segments import (
    BODY as BODY,
    DEFAULT_SIGMA_PX as DEFAULT_SIGMA_PX,
    Junctions as Junctions,
    LineObservations as LineObservations,
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
