"""One calibration problem: variables on manifolds, factors that observe them, one solver.

`variables` are lenses, cameras, boards and how these were made, with their priors (`sheet` bends a
board); `views` are what was seen of them; `places` are the factor that all fits share;
`equations` sums them up, `solver` minimises. `problem` holds all this, `starting_problem` begins
it, `robust_fit` ends it without what is wrong. `information` says what it determines,
`named_covariance` in the terms that people use, `rao_test` what else the views ask for."""
