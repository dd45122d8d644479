"""trinoc/match/tracks."""
