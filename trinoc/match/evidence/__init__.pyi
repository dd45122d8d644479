from .endpoints import (
    END_COMPONENTS as END_COMPONENTS,
    end_evidence as end_evidence,
    reach_of_ends as reach_of_ends,
)
from .junction_geometry import log_gap_density as log_gap_density, passing as passing
from .mixture import (
    MixtureParameters as MixtureParameters,
    Volume as Volume,
    em_step as em_step,
    log_odds as log_odds,
    log_place as log_place,
    log_sides as log_sides,
    prior_parameters as prior_parameters,
    probability as probability,
    temper as temper,
    volume_of as volume_of,
)
from .side_intensity import (
    SIDE_COMPONENTS as SIDE_COMPONENTS,
    polarity_evidence as polarity_evidence,
    side_evidence as side_evidence,
)
from .triple_position import (
    PairEvidence as PairEvidence,
    TripleEvidence as TripleEvidence,
    line_of_three as line_of_three,
    pair_evidence as pair_evidence,
    triple_evidence as triple_evidence,
)
