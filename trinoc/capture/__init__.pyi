from .advice import (
    field as field,
    field_share as field_share,
    next_step as next_step,
    shows_something_new as shows_something_new,
)
from .annotated import failure_picture as failure_picture
from .exposure import Exposure as Exposure, exposure_of as exposure_of
from .judgement import Judgement as Judgement, judge as judge, judge_unread as judge_unread
from .placement import GRID as GRID, covered_cells as covered_cells, lean_of as lean_of
from .sharpness import edge_blur_px as edge_blur_px
from .words import judgement_line as judgement_line, summary_lines as summary_lines
