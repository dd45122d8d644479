from .table import Candidates as Candidates
from .table import concatenated as concatenated
from .table import in_depth_range as in_depth_range
from .table import no_candidates as no_candidates
from .table import prior_log_odds as prior_log_odds
from .triples import trinocular_candidates as trinocular_candidates
