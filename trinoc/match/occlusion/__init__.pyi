from .pairs import Pairs as Pairs, occluded_pairs as occluded_pairs
