"""Every tuned constant of calibration, in one frozen value.

Code reads `TUNING` of `every_group.py`, which is not handed from function to function; to try
other values, `python benchmarks/sweep.py calib.rig_check.moved_sigmas 4 5` replaces it in a fresh
process before anything else is imported. A comment says the unit and on what a value was chosen:
"by hand" where no benchmark was asked. Numerical guards, block sizes, and the steps and tolerances
of iterations that converge stand where they are used, marked `# numerical:`.
"""
