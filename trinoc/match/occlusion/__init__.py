"""trinoc/match/occlusion."""
