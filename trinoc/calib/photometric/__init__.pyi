from .image_fit import ShiftOfPlaces as ShiftOfPlaces, refine_image as refine_image
from .views import (
    PictureFit as PictureFit,
    in_threads as in_threads,
    refine_views as refine_views,
)
