from .learned import Learned as Learned, Region as Region, region_of as region_of
from .search import gated_triples as gated_triples, prepared_orders as prepared_orders
from .table import (
    Candidates as Candidates,
    candidates_at as candidates_at,
    in_depth_range as in_depth_range,
    no_candidates as no_candidates,
    prior_log_odds as prior_log_odds,
)
from .triples import (
    candidates_among as candidates_among,
    candidates_of as candidates_of,
    trinocular_candidates as trinocular_candidates,
)
