"""trinoc/match/two_view."""
