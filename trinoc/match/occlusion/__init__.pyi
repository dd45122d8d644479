from .pair_evidence import Pairs as Pairs
from .pairs import occluded_pairs as occluded_pairs
