"""What lens and sensor make of a picture: blur, the pixel's box, noise, grey levels."""

import numpy as np
from jaxtyping import Float, Int
from scipy.special import ndtr

GREY_DTYPES = ("uint8", "uint16", "float64")


def blur_and_integrate(
    centre_grey: Float[np.ndarray, "h w"],
    cell_grey: Float[np.ndarray, "m s s"],
    divided: Int[np.ndarray, "m 2"],
    *,
    blur_px: float,
    margin_px: int,
) -> Float[np.ndarray, "h_out w_out"]:
    """The grey levels convolved with Gaussian and pixel box, at the pixels' centres.

    The canvas is constant over each pixel, and over each cell of a divided pixel (`divided`
    holds their rows and columns), and the convolution of that is exact: nothing is sampled at
    the pixels before it is blurred. `margin_px` is cut off on every side; it
    should reach `blur_reach_px`. Source: the integral of Phi is z Phi(z) + phi(z).
    """
    reach = blur_reach_px(blur_px)
    # Grey levels that are constant over a cell have been blurred by its box already, on average.
    sigma_px = np.sqrt(max(blur_px**2 - 1 / (12 * cell_grey.shape[1] ** 2), 0.0))
    whole = _weights(1, reach, sigma_px)[:, 0]
    blurred = _convolve_rows(_convolve_rows(centre_grey, whole).T, whole).T
    cells = _weights(cell_grey.shape[1], reach, sigma_px)
    excess = cell_grey - centre_grey[divided[:, 0], divided[:, 1], None, None]
    spread = cells @ excess @ cells.T
    height, width = centre_grey.shape
    padded = np.zeros((height + 2 * reach, width + 2 * reach))
    for i in range(2 * reach + 1):
        for j in range(2 * reach + 1):
            # Each divided pixel is listed once, so that no sum of this line is lost.
            padded[divided[:, 0] + i, divided[:, 1] + j] += spread[:, i, j]
    total = blurred + padded[reach : reach + height, reach : reach + width]
    return total[margin_px : height - margin_px, margin_px : width - margin_px]


def blur_reach_px(blur_px: float) -> int:
    """How many pixels away a grey level still counts: five sigmas and the pixel's half."""
    return int(np.ceil(5 * blur_px + 0.5))


def expose(
    grey: Float[np.ndarray, "h w"],
    *,
    noise_sigma: float | Float[np.ndarray, "h w"],
    seed: int,
    dtype: str,
) -> np.ndarray:
    """The picture that is read out, with Gaussian noise.

    `noise_sigma` is in grey levels: one number, or one per pixel.

    Grey levels run from 0 to 255 whatever the dtype: "uint8" clips and rounds them, "uint16"
    does so after a factor of 257, "float64" leaves them as they are.
    """
    noisy = grey + noise_sigma * np.random.default_rng(seed).normal(size=grey.shape)
    if dtype == "float64":
        return noisy
    if dtype not in GREY_DTYPES:
        raise ValueError(f'dtype is "{dtype}", but must be one of {", ".join(GREY_DTYPES)}.')
    scale = 1 if dtype == "uint8" else 257
    return np.rint(np.clip(noisy, 0.0, 255.0) * scale).astype(dtype)


def _weights(cells: int, reach: int, blur_px: float) -> Float[np.ndarray, "k cells"]:
    """Weight, at pixels -reach ... reach away, of each cell of a pixel along one axis."""
    edges = np.arange(cells + 1) / cells - 0.5
    distance = edges[None, :] - np.arange(-reach, reach + 1)[:, None]
    sigma = max(blur_px, 1e-6)
    integral = sigma * (_integral_of_phi((distance + 0.5) / sigma))
    integral -= sigma * (_integral_of_phi((distance - 0.5) / sigma))
    weights = np.diff(integral, axis=1)
    return weights / weights.sum()


def _integral_of_phi(z: np.ndarray) -> np.ndarray:
    return z * ndtr(z) + np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)


def _convolve_rows(
    image: Float[np.ndarray, "h w"], weights: Float[np.ndarray, "k"]
) -> Float[np.ndarray, "h w"]:
    """Convolution along axis 0; past its border the picture repeats its last row."""
    reach = len(weights) // 2
    padded = np.pad(image, ((reach, reach), (0, 0)), mode="edge")
    return sum(
        (w * padded[i : i + len(image)] for i, w in enumerate(weights)), np.zeros_like(image)
    )
