from .any_target import detect_target as detect_target
from .board_set import split_by_board as split_by_board
from .detection import Detection as Detection
from .orientation import Orientation as Orientation, oriented as oriented
from .search import circle_candidates as circle_candidates, detect_pattern as detect_pattern
