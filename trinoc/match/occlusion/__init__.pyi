from .pair_evidence import Pairs as Pairs
from .pairs import occluded_pairs as occluded_pairs
from .possible_pairs import rehearse_pairs as rehearse_pairs
from .solids import bodies_of as bodies_of, tempered_tracks as tempered_tracks
