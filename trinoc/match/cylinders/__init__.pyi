from .cylinders import Cylinders as Cylinders
from .search import find_cylinders as find_cylinders
