"""The names of the steps after matching, which the command's help lists without importing them."""

from typing import Literal

StepName = Literal["pixels", "rims", "wireframe"]
