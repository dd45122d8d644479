"""Matched lines measured in the grey levels of all their views: `measure.py` fits each line to the
pixels beside it."""
