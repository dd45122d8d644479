from .exclusivity import (
    CONFLICT_OVERLAP as CONFLICT_OVERLAP,
    chosen_greedily as chosen_greedily,
    claimed as claimed,
    conflict_graph as conflict_graph,
    sum_product as sum_product,
)
from .junction_support import (
    PRIOR_PARAMETERS as PRIOR_PARAMETERS,
    JunctionParameters as JunctionParameters,
    endpoint_pairs as endpoint_pairs,
    junction_log_odds as junction_log_odds,
)
from .marginals import (
    MIN_AT_JUNCTION as MIN_AT_JUNCTION,
    PRUNE_LOG_ODDS as PRUNE_LOG_ODDS,
    Selection as Selection,
    Tracks as Tracks,
    select as select,
    tracks_of as tracks_of,
)
