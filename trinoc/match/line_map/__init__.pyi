from .collinear_merge import join_collinear as join_collinear
from .corner_fit import snap_corners as snap_corners
from .corners import Corners as Corners
from .lines import JoinedLines as JoinedLines
