from .advice import (
    field as field,
    field_share as field_share,
    next_step as next_step,
    shows_something_new as shows_something_new,
    summary_lines as summary_lines,
)
from .annotated import failure_picture as failure_picture
from .judgement import (
    Judgement as Judgement,
    judge as judge,
    judge_unread as judge_unread,
    judgement_line as judgement_line,
)
from .measures import (
    GRID as GRID,
    Exposure as Exposure,
    covered_cells as covered_cells,
    edge_blur_px as edge_blur_px,
    exposure_of as exposure_of,
    lean_of as lean_of,
)
