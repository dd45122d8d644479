from .lens_parameters import (
    LENS_PARAMETERS as LENS_PARAMETERS,
    lens_of_values as lens_of_values,
    parameter_scale as parameter_scale,
)
