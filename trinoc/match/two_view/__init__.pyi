from .epipolar_pencil import (
    Pencil as Pencil,
    PencilSegments as PencilSegments,
    cut_pair as cut_pair,
    end_angles as end_angles,
    pairs_sharing_planes as pairs_sharing_planes,
    pencil as pencil,
    pencil_of as pencil_of,
    plane_angles as plane_angles,
    points_of as points_of,
    row_of as row_of,
)
from .planes import (
    InterpretationPlanes as InterpretationPlanes,
    Sight as Sight,
    extents_on_line as extents_on_line,
    image_length_px as image_length_px,
    interpretation_planes as interpretation_planes,
    sight_of as sight_of,
    variance_mm2 as variance_mm2,
)
