"""How much evidence a segment needs so that noise alone rarely makes one.

The evidence of a segment is E = n (m / s)^2 for n edge points of mean strength m, where s is
the standard deviation of the gradient that noise alone gives. On pictures of white noise the
number of segments per megapixel whose evidence exceeds E falls as RATE exp(-E / DECAY); both
numbers were fitted to such pictures (benchmarks/segments.py repeats the measurement) and
hold for point thresholds of 2.5 s and above.
"""

import numpy as np

RATE_PER_MEGAPIXEL = 4.2e4
DECAY = 12.0


def least_snr2(false_alarms: float, pixels: int) -> float:
    """Evidence that noise exceeds `false_alarms` times, on average, in so many pixels."""
    return DECAY * float(np.log(max(RATE_PER_MEGAPIXEL * pixels / 1e6 / false_alarms, 1.0)))
