"""Every tuned constant of calibration, in one frozen value.

Calibrations take a `CalibTuning` as `tuning`, and a `Problem` carries it; `TUNING` of
`every_group.py` is its default. Only `photometric` reads the default itself, in compiled programs.
To try other values, `python benchmarks/sweep.py calib.rig_check.moved_sigmas 4 5` replaces `TUNING`
in a fresh process before anything else is imported. A comment says the unit and on what a value was
chosen: "by hand" where no benchmark was asked. Numerical guards, block sizes, and the steps and
tolerances of iterations that converge stand where they are used, marked `# numerical:`.
"""
