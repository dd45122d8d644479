from .image_fit import refine_image as refine_image
from .views import ViewEstimate as ViewEstimate
from .views import in_threads as in_threads
from .views import refine_views as refine_views
