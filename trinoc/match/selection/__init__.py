"""trinoc/match/selection."""
