from .estimate import (
    DEGREES as DEGREES,
    PoseEstimate as PoseEstimate,
    pose_of_values as pose_of_values,
    values_of_parameters as values_of_parameters,
)
from .point_least_squares import (
    PointFit as PointFit,
    fit_points as fit_points,
    image_shifts as image_shifts,
)
from .views import fit_views as fit_views
