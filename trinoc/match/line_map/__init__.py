"""trinoc/match/line_map."""
