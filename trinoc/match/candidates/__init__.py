"""trinoc/match/candidates."""
