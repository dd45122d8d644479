from .advice import NextImage as NextImage
from .field import field_places_px as field_places_px, field_sigma_px as field_sigma_px
from .from_images import lens_of_circles as lens_of_circles
from .lens_messages import notes_of_lens as notes_of_lens
from .lens_parameters import LensModel as LensModel
from .next_picture import next_image as next_image
from .result import IntrinsicsResult as IntrinsicsResult
from .robust_lens import LensImages as LensImages
from .zhang import FEWEST_CIRCLES as FEWEST_CIRCLES, zhang_start as zhang_start
