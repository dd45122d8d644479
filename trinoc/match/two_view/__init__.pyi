from .common_part import cut_pair as cut_pair, points_of as points_of
from .epipolar_pencil import (
    Pencil as Pencil,
    PencilSegments as PencilSegments,
    pencil as pencil,
    pencil_of as pencil_of,
    plane_angles as plane_angles,
    row_of as row_of,
)
from .planes import (
    InterpretationPlane as InterpretationPlane,
    extent_on_line as extent_on_line,
    image_of as image_of,
    interpretation_plane as interpretation_plane,
)
