"""Every tuned constant of the matcher, in one frozen value that a benchmark can vary.

    tuning = with_field(MatchTuning(), "selection.damping", 0.5)     # trinoc.numerics
    matches = match_segments(segments, rig, tuning=tuning)

The docstring of each group names the benchmark that shows its effect. `benchmarks/sweep.py` tries
other values. Most values were chosen by hand on simulated scenes, or come from the prototype, an
earlier numerical study. A comment states where a value was fitted or measured, and on which data.

The numbers of scales and of components are fixed, because tables have a column for each. Block
sizes, layers of the spatial index and numerical guards are not tuned. They are in the files that
use them, with the mark `# numerical:`, and should not affect any result. `collinear_share` and the
constants `narrow_...` are read from `DEFAULT`; change `DEFAULT` to try others.
"""
