"""Cameras, rigs, images of circles, epipolar geometry, lines and triangulation.

Functions are pure JAX for one item; use `vmap` for many. The values that calibration and matching
share (`Camera`, `Rig`, `Segments`, `Junctions`, `LineObservations`) are defined here. Source:
Hartley and Zisserman, "Multiple View Geometry" (2003).
"""

from trinoc.geometry.camera import (
    project as project,
    sheet_from_pixel as sheet_from_pixel,
)
from trinoc.geometry.epipolar import (
    epipolar_distance_px as epipolar_distance_px,
    epipolar_line as epipolar_line,
    fundamental_matrix as fundamental_matrix,
)
from trinoc.geometry.intrinsics import (
    distort_pixels as distort_pixels,
    undistort_pixels as undistort_pixels,
)
from trinoc.geometry.lenses.abstract_lens import (
    AbstractLens as AbstractLens,
)
from trinoc.geometry.lines import (
    line_through as line_through,
    plane_of_line as plane_of_line,
)
from trinoc.geometry.pose import (
    Pose as Pose,
)
from trinoc.geometry.projection import (
    project_points as project_points,
)
from trinoc.geometry.segments import (
    Junctions as Junctions,
    LineObservations as LineObservations,
)
from trinoc.geometry.triangulation import (
    triangulate_point as triangulate_point,
    triangulate_segment as triangulate_segment,
)
from trinoc.geometry.uncertain_lines import (
    UncertainLines as UncertainLines,
    angle_deg as angle_deg,
    distance_mm as distance_mm,
    length_mm as length_mm,
)
