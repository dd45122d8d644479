from .encoding import Encoding as Encoding, Response as Response
from .image_fit import refine_image as refine_image
from .image_problem import ShiftOfPlaces as ShiftOfPlaces
from .mosaic import neutral_mosaic as neutral_mosaic
from .views import (
    PictureFit as PictureFit,
    in_threads as in_threads,
    refine_views as refine_views,
)
