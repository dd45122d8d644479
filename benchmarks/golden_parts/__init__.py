"""Parts of `golden.py`: a file for each area of the package, the inputs and the records."""

from golden_parts.calibration import (
    calibrate_circles,
    calibrate_delivered,
    calibrate_lit,
    calibrate_pictures,
    calibrate_suspect,
    points,
)
from golden_parts.edges import capture, segments
from golden_parts.exports import exports
from golden_parts.joint import refine, refine_made, rig_check
from golden_parts.matching import (
    made,
    matching,
    measured_lines,
    photographs,
    rims,
    shared,
    wire_frame,
)
from golden_parts.shots import lens, rig_options, rig_pixels, rig_points

PARTS = {
    part.__name__: part
    for part in (
        *(calibrate_circles, calibrate_pictures, calibrate_delivered, calibrate_lit),
        *(calibrate_suspect, points, lens, rig_points, rig_options, rig_pixels),
        *(refine, refine_made, rig_check, segments, capture, matching, made),
        *(measured_lines, wire_frame, rims, exports, shared, photographs),
    )
}

__all__ = ["PARTS"]
