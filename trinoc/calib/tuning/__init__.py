"""Tuned constants of calibration, collected in one frozen value.

Calibrations take a `CalibTuning` as their argument `tuning`; its default is `TUNING` of
`every_group.py`. A `Problem` carries its tuning. To try other values, run for example
`python benchmarks/sweep.py calib.rig_check.moved_sigmas 4 5`, which replaces `TUNING` in a fresh
process before other imports.

The comment at a constant states its unit and how the value was chosen. "By hand" means without a
benchmark. Numerical guards, block sizes, and steps and tolerances of convergent iterations are
defined where they are used, marked `# numerical:`.
"""
