"""The noise of a picture, from the picture itself."""

import numpy as np
from jaxtyping import Float

# Rows enough for an estimate good to one part in a hundred; more would only cost time.
_MOST_ROWS = 60
QUANTISATION_SIGMA = float(np.sqrt(1 / 12))
# Pictures of real numbers are taken to be good to this share of their range.
LEAST_OF_RANGE = 1e-4


def noise_sigma(grey: Float[np.ndarray, "h w"], quantum: float) -> float:
    """Standard deviation of the noise, in grey levels.

    The product of the second differences along u and v is zero on ramps and on
    straight edges along either axis; the median of its size is not moved by the few corners
    and oblique edges that are left (J. Immerkaer, "Fast noise variance estimation", Computer
    Vision and Image Understanding 64(2), 1996, with a median in place of its mean). `quantum`
    is the step between two grey levels (0 for real numbers); its rounding noise is a floor,
    and so is a ten-thousandth of the range of real numbers.
    """
    step = max(1, (grey.shape[0] - 2) // _MOST_ROWS)
    down = grey[:-2:step] + grey[2::step] - 2 * grey[1:-1:step]
    size = np.abs(down[:, :-2] + down[:, 2:] - 2 * down[:, 1:-1]).ravel()
    middle = len(size) // 2
    median = float(np.partition(size, middle)[middle])
    if quantum:
        # Few distinct answers: where inside its step the median lies tells their counts.
        below, equal = np.count_nonzero(size < median), np.count_nonzero(size == median)
        median = max(0.0, median + quantum * ((middle + 0.5 - below) / equal - 0.5))
    floor = QUANTISATION_SIGMA * quantum if quantum else LEAST_OF_RANGE * float(np.ptp(grey))
    return max(median / 0.6745 / 6, floor, float(np.finfo(np.float32).tiny) ** 0.25)
