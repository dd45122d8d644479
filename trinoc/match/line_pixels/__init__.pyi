from .measure import measure_lines as measure_lines
from .tuning import PixelTuning as PixelTuning
