from .detection import Detection as Detection
from .orientation import Orientation as Orientation, oriented as oriented
from .search import detect_pattern as detect_pattern
