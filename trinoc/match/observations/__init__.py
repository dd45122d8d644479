"""trinoc/match/observations."""
