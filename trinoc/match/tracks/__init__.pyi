from .assembly import assemble as assemble
from .consolidation import consolidated as consolidated
from .extent import positions_abreast as positions_abreast
from .matches import Matches as Matches
from .multiview import merge_triplets as merge_triplets, view_triplets as view_triplets
from .viewpoint import typical_misfit as typical_misfit
