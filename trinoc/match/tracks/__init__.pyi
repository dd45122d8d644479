from .assembly import assemble as assemble
from .consolidation import consolidated as consolidated
from .extent import (
    common_ends as common_ends,
    interval_of as interval_of,
    positions_abreast as positions_abreast,
    reach_of as reach_of,
)
from .fragments import ending_view as ending_view, fragments_of as fragments_of
from .line_fit import direction_doubt as direction_doubt, lines_in_space as lines_in_space
from .matches import (
    BINOCULAR as BINOCULAR,
    EVEN as EVEN,
    TRINOCULAR as TRINOCULAR,
    Matches as Matches,
)
from .multiview import merge_triplets as merge_triplets, view_triplets as view_triplets
from .unequal_errors import (
    degrees_of_misfit as degrees_of_misfit,
    learned_tail as learned_tail,
    scaled_across as scaled_across,
    variance_factor as variance_factor,
)
from .viewpoint import (
    flag_viewpoint_dependent as flag_viewpoint_dependent,
    typical_misfit as typical_misfit,
)
