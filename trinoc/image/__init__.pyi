from .grey import GreyImage as GreyImage, grey_image as grey_image
from .light import Light as Light
from .noise import level_noise as level_noise, noise_sigma as noise_sigma
from .response import (
    AbstractResponse as AbstractResponse,
    PowerResponse as PowerResponse,
    ResponseLike as ResponseLike,
    response_of as response_of,
)
from .step_edge import (
    BlockFit as BlockFit,
    blur_of_two_slopes as blur_of_two_slopes,
    blurred_step as blurred_step,
    fit_block as fit_block,
    fit_profiles as fit_profiles,
    height_of_step as height_of_step,
    log_parabola as log_parabola,
    peak_of_slope as peak_of_slope,
)
from .strip import (
    levels_between as levels_between,
    levels_of as levels_of,
    nearest_levels as nearest_levels,
    pixels_across as pixels_across,
)
