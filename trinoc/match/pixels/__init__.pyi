from .guide import GuidedMatches as GuidedMatches, guide_matches as guide_matches
from .measure import measure_lines as measure_lines
from .tuning import PixelTuning as PixelTuning
