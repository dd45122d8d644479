"""Matched lines in the grey levels of all their views: asked for again, and measured again.

`guide.py` asks every picture where matched lines must be, which finds what no search of one picture
alone does; `measure.py` fits lines to the pixels beside them.
"""
