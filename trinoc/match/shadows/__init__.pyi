from .search import find_shadows as find_shadows
from .shadows import Shadows as Shadows
