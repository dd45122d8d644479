"""Names of the steps after matching. The help of the command lists them without importing the
steps.
"""

from typing import Literal

StepName = Literal["pixels", "rims", "wireframe"]
