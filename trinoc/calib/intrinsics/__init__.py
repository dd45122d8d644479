"""The lens of one camera from several images of the sheet, with covariance and advice.

zhang (first lens and poses) -> lens_residual, lens_fit -> robust_lens -> model_choice ->
lens_information, field -> next_image -> assessment, lens_messages -> result; `from_images` is the
door that users take."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
