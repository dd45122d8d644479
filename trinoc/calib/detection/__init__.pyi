from .circles import circle_candidates as circle_candidates
from .detection import Detection as Detection, split_by_board as split_by_board
from .orientation import Orientation as Orientation, resolve_orientation as resolve_orientation
from .registry import detect_pattern as detect_pattern, detect_target as detect_target
