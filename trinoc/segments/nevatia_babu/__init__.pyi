from .accept import (
    Shifts as Shifts,
    SideSlopes as SideSlopes,
    is_on_ramp as is_on_ramp,
    is_sharp as is_sharp,
    is_straight as is_straight,
    least_snr2 as least_snr2,
    shading_shifts as shading_shifts,
    side_slopes as side_slopes,
    typical_blur as typical_blur,
)
from .endpoints import (
    NearEnds as NearEnds,
    Pieces as Pieces,
    end_sigmas as end_sigmas,
    endpoint_crossings as endpoint_crossings,
    lines_near_ends as lines_near_ends,
    snap_ends as snap_ends,
)
from .errors import (
    ErrorModel as ErrorModel,
    end_covariances as end_covariances,
    error_model as error_model,
    find_overlaps as find_overlaps,
    inflate_variance as inflate_variance,
    noise_variance as noise_variance,
    without_neighbours as without_neighbours,
)
from .line_fit import (
    FittedLines as FittedLines,
    fit_lines as fit_lines,
    merge_collinear as merge_collinear,
)
from .runs import Level as Level, Runs as Runs, find_runs as find_runs, full_level as full_level
from .saturated_edges import shifts_of_saturated as shifts_of_saturated
from .thinning import combined_kernel as combined_kernel
