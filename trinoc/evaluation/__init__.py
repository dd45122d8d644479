"""How accurate lines in space are: against known shapes, made scenes and published matches."""
