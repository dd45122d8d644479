from .table import (
    Candidates as Candidates,
    in_depth_range as in_depth_range,
    no_candidates as no_candidates,
    prior_log_odds as prior_log_odds,
)
from .triples import trinocular_candidates as trinocular_candidates
