from .rims import Rims as Rims
from .search import find_rims as find_rims
