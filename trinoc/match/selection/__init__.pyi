from .exclusivity import (
    affordable as affordable,
    claimed as claimed,
    conflict_graph as conflict_graph,
)
from .junction_support import (
    JunctionParameters as JunctionParameters,
    endpoint_pairs as endpoint_pairs,
    junction_log_odds as junction_log_odds,
    prior_junctions as prior_junctions,
)
from .marginals import (
    Selection as Selection,
    Tracks as Tracks,
    select as select,
    tracks_of as tracks_of,
)
from .messages import (
    FRAMES_AT_ONCE as FRAMES_AT_ONCE,
    Beliefs as Beliefs,
    chosen_greedily as chosen_greedily,
    sum_product as sum_product,
)
from .noise_scale import residual_scale as residual_scale
