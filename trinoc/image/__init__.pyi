from .grey import GreyImage as GreyImage, grey_image as grey_image
from .light import Light as Light
from .noise import level_noise as level_noise, noise_sigma as noise_sigma
from .response import (
    AbstractResponse as AbstractResponse,
    PowerResponse as PowerResponse,
    ResponseLike as ResponseLike,
    response_of as response_of,
)
