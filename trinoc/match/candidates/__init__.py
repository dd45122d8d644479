"""Step 1 of the paper: triples of segments that can be images of one line.

`third_view` predicts the image of a pair. `index` lists the segments near a prediction. `search`
applies the gate. `triples` runs this for all three orderings of the views and returns the value
of `table`.
"""
