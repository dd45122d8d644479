from .pairs import match_occluded as match_occluded, occluded_pairs as occluded_pairs
from .possible_pairs import Pairs as Pairs, rehearse_pairs as rehearse_pairs
from .solids import bodies_of as bodies_of, tempered_tracks as tempered_tracks
