from .camera import (
    CameraState as CameraState,
    camera_of_state as camera_of_state,
    camera_state as camera_state,
    stacked_states as stacked_states,
)
from .circle_residual import (
    circle_residuals_px as circle_residuals_px,
    predicted_centre_px as predicted_centre_px,
    whitened_residuals as whitened_residuals,
)
from .observed_circles import (
    CircleObservations as CircleObservations,
    bucket_size as bucket_size,
    circle_observations as circle_observations,
    stack_observations as stack_observations,
    whitening_of_covariance as whitening_of_covariance,
)
from .outliers import (
    ANNEALING as ANNEALING,
    GATE as GATE,
    inliers as inliers,
    is_suspect as is_suspect,
    robust_scale as robust_scale,
)
from .sheet_points import SheetPoints as SheetPoints
