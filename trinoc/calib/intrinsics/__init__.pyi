from .field import field_places_px as field_places_px, field_sigma_px as field_sigma_px
from .from_images import lens_of_circles as lens_of_circles
from .lens_parameters import LensModel as LensModel
from .next_picture import next_image as next_image
from .result import IntrinsicsResult as IntrinsicsResult
from .zhang import FEWEST_CIRCLES as FEWEST_CIRCLES, zhang_start as zhang_start
