from .guide import GuidedMatches as GuidedMatches, guide_matches as guide_matches
