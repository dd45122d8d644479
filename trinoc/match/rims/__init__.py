"""After matching: circular rims, from the chords that the views show of them.

Pairs of matched lines propose circles, and the segments of all views support them. Each circle
is fitted, ambiguous ones are rejected, and the others are returned with sigmas.
"""
