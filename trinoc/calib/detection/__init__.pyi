from .detection import Detection as Detection
from .grey import grey_image as grey_image
from .orientation import Orientation as Orientation, oriented as oriented
from .search import detect_pattern as detect_pattern
