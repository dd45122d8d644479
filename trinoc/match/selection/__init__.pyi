from .junction_support import (
    JunctionParameters as JunctionParameters,
    endpoint_pairs as endpoint_pairs,
    junction_log_odds as junction_log_odds,
    prior_junctions as prior_junctions,
)
from .marginals import (
    Selection as Selection,
    Tracks as Tracks,
    learn_noise_scale as learn_noise_scale,
    select as select,
    tracks_of as tracks_of,
)
from .messages import (
    FRAMES_AT_ONCE as FRAMES_AT_ONCE,
    Beliefs as Beliefs,
    affordable as affordable,
    chosen_greedily as chosen_greedily,
    claimed as claimed,
    conflict_graph as conflict_graph,
    sum_product as sum_product,
)
