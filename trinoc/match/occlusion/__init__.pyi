from .pair_evidence import Pairs as Pairs
from .pairs import occluded_pairs as occluded_pairs
from .solids import solid_share as solid_share, tempered_tracks as tempered_tracks
