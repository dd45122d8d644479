from .abstract_lens import AbstractLens as AbstractLens
from .pinhole import Pinhole as Pinhole
from .registry import DEFAULT_DISTORTION as DEFAULT_DISTORTION, lens_model as lens_model
