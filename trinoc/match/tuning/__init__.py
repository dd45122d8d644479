"""Every tuned constant of the matcher, in one frozen value that can be swept.

    tuning = with_field(MatchTuning(), "selection.damping", 0.5)     # trinoc.numerics
    matches = match_segments(segments, rig, tuning=tuning)

Each group says which figure shows it; `benchmarks/sweep.py` tries other values. Most values were
chosen by hand, on made scenes, or come from the prototype, a numerical study that went before; a
comment says where one was fitted or measured, and on what. Numbers of scales and of components
are fixed: tables have a column for each. Block sizes, the layers of the table of cells and
numerical guards stand where they are used, marked `# numerical:`, as no answer should depend on
them. `in_line_share` and `narrow_share` with what belongs to it are read from `DEFAULT`; to try
others, change that.
"""
