"""Circular rims by the chords that the views show of them.

Pairs of matched lines suggest circles; the segments of all views support them; each circle is
fitted, its rivals are left out, and it is put out with sigmas.
"""
