"""Log likelihood ratios of one line against clutter, and the mixtures that EM estimates.

`triple_position`: position and direction, also of pairs. `endpoints`: positions of the ends
along the line. `side_intensity`: the darker side, and the grey levels on both sides. `mixture`:
the sum of all.
"""
