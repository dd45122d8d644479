"""Kinds of features in space. Files, exports, views and cards read this list."""

from trinoc.geometry.features import Feature
from trinoc.match.rims.rims import Rims
from trinoc.match.wire_frame.frame import Wireframe

FEATURES: list[type[Feature]] = [Wireframe, Rims]
