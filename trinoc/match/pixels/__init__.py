"""After matching: fit the matched lines to the grey levels of all their views; `measure.py` runs
this.
"""
