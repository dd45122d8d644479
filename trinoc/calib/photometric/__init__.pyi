from .image_fit import refine_image as refine_image
from .views import (
    ViewEstimate as ViewEstimate,
    in_threads as in_threads,
    refine_views as refine_views,
)
