from .lens_parameters import LENS_PARAMETERS as LENS_PARAMETERS
from .lens_parameters import lens_of_values as lens_of_values
from .lens_parameters import parameter_scale as parameter_scale
