"""Step 2 of the paper: decide which candidates are right, from their evidence, rivals and
neighbours.

`messages`: exclusion of rivals by sum-product. `junction_support`: ends that meet in space.
`repetition`: repeated patterns, where wrong partners fit as well. `marginals` runs the first two
together.
"""
