"""Adjustment of the cameras over one sheet, with sheet, lenses and aims as unknowns.

`single_camera` fits one camera to its circles, `adjustment` all cameras together. `agreement`
chooses grey levels or circles. `model_tests` tests fixed parameters, `prior_pulls` tests priors,
and `measurement_advice` names the measurement that would help most.
"""
