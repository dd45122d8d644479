"""trinoc/match/evidence."""
