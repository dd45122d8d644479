from .cylinder_search import find_cylinders as find_cylinders
from .cylinders import Cylinders as Cylinders
from .rim_search import find_rims as find_rims
from .rims import Rims as Rims
from .rims_beside_edges import MatchesWithRims as MatchesWithRims, add_rims as add_rims
from .shadow_search import Shadows as Shadows, find_shadows as find_shadows
