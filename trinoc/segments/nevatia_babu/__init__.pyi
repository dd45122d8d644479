from .accept import is_sharp as is_sharp, is_straight as is_straight, typical_blur as typical_blur
from .bridge_gaps import bridged_runs as bridged_runs, collinear_successors as collinear_successors
from .covariance import end_covariances as end_covariances, noise_variance as noise_variance
from .edge_errors import error_model as error_model, inflate_variance as inflate_variance
from .edge_interference import overlaps as overlaps, without_neighbours as without_neighbours
from .edge_points import EdgePoints as EdgePoints
from .endpoints import (
    NearEnds as NearEnds,
    end_sigmas as end_sigmas,
    endpoint_crossings as endpoint_crossings,
    lines_near_ends as lines_near_ends,
    snapped_ends as snapped_ends,
)
from .line_fit import FittedLines as FittedLines, fit_lines as fit_lines
from .masks import combined_kernel as combined_kernel
from .nfa import least_snr2 as least_snr2
from .pyramid import fine_level as fine_level
from .saturated_edges import shifts_of_saturated as shifts_of_saturated
from .shading import (
    is_on_ramp as is_on_ramp,
    shading_shifts as shading_shifts,
    side_slopes as side_slopes,
)
from .shifts import Shifts as Shifts
from .two_scale import runs_of_both_scales as runs_of_both_scales
