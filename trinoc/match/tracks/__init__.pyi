from .assembly import (
    assemble as assemble,
    direction_doubt as direction_doubt,
    flag_viewpoint_dependent as flag_viewpoint_dependent,
    typical_misfit as typical_misfit,
)
from .consolidation import (
    consolidated as consolidated,
    tracks_through_views as tracks_through_views,
)
from .line_fit import (
    common_ends as common_ends,
    ending_view as ending_view,
    fragments_of as fragments_of,
    interval_of as interval_of,
    lines_in_space as lines_in_space,
    positions_abreast as positions_abreast,
    reach_of as reach_of,
)
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
