"""Every tuned constant of calibration, in one frozen value.

`detection` and `starts` take a `CalibTuning` as `tuning`; the other rooms read `TUNING` of
`every_group.py`. To try other values of any room,
`python benchmarks/sweep.py calib.rig_check.moved_sigmas 4 5` replaces `TUNING` in a fresh process
before anything else is imported. A comment says the unit and on what a value was chosen:
"by hand" where no benchmark was asked. Numerical guards, block sizes, and the steps and tolerances
of iterations that converge stand where they are used, marked `# numerical:`.
"""
