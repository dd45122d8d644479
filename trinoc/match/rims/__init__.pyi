from .added import MatchesWithRims as MatchesWithRims, add_rims as add_rims
from .rims import Rims as Rims
from .search import find_rims as find_rims
