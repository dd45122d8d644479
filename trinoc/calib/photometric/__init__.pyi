from .encoding import (
    Encoding as Encoding,
    Response as Response,
    neutral_mosaic as neutral_mosaic,
)
from .image_fit import refine_image as refine_image
from .scene import ShiftOfPlaces as ShiftOfPlaces
from .views import (
    PictureFit as PictureFit,
    in_threads as in_threads,
    refine_views as refine_views,
)
