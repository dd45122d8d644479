from .collinear_merge import join_collinear as join_collinear
from .corners import Corners as Corners, snap_corners as snap_corners
from .lines import JoinedLines as JoinedLines
