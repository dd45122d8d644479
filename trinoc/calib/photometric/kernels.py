"""Kernels that are no Gaussian, and the share of a pixel that an edge inks under them.

A kernel is a Gaussian whose width depends on the edge's direction, with cumulants beyond the
second as in Edgeworth's series: flat-topped as a defocus disc or a moved picture.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.calib.photometric.edges import Coverage, Edge
from trinoc.numerics import ArrayLike

Scalar = Float[ArrayLike, ""]

# As for a Gaussian (`edges`).
_REACH = 6.0
_LEAST_VARIANCE = 0.01
# Excess kurtosis of a line of even light.
_LINE_KURTOSIS = -1.2


class Kernel(NamedTuple):
    """What blurs a picture, the pixel's box included.

    Fields
    ------
    sigma_px : rms width along one axis, the mean over all directions.
    kurtosis, sixth : cumulants over powers of sigma, 0 for a Gaussian.
    along_u, diagonal : (variance along u - along v) / 2, and covariance of u and v, px^2.
    along_axes : variance across edges along the picture's axes less that across diagonal ones,
        halved, px^2.
    line : 1 where the anisotropy is that of a straight motion, 0 where it is a Gaussian's.
    """

    sigma_px: Scalar
    kurtosis: Scalar
    sixth: Scalar
    along_u: Scalar
    diagonal: Scalar
    along_axes: Scalar
    line: Scalar

    def widened(self, by_px: Scalar) -> "Kernel":
        """Its Gaussian, blurred once more."""
        sigma, zero = jnp.sqrt(self.sigma_px**2 + by_px**2), jnp.zeros_like(self.sigma_px)
        return Kernel(sigma, zero, zero, self.along_u, self.diagonal, zero, zero)


def kernel_coverage(edge: Edge, shift_mm: Scalar, kernel: Kernel) -> Coverage:
    """Share of the pixel with ink, where F has grown by `shift_mm`."""
    even = edge.normal_u * edge.normal_u - edge.normal_v * edge.normal_v
    odd = 2 * edge.normal_u * edge.normal_v
    swing = kernel.along_u * even + kernel.diagonal * odd
    middle = kernel.sigma_px * kernel.sigma_px
    quarter = kernel.along_axes * (even * even - odd * odd)
    variance = jnp.maximum(middle + swing + quarter, _LEAST_VARIANCE)
    aside = jnp.maximum(middle - swing + quarter, _LEAST_VARIANCE)
    sigma = jnp.sqrt(variance)
    reach = _REACH * sigma
    distance = jnp.clip(edge.distance + shift_mm / edge.gradient, -reach, reach)
    half = jnp.clip(0.5 * edge.curvature * aside / sigma, -0.5, 0.5)
    shift = half + 3 * half**3 + edge.curvature_change * sigma**3 / 8
    score = -(distance / sigma + shift) / jnp.sqrt(1 + 2 * half * half)
    density = jnp.exp(-0.5 * score * score) * 0.3989422804014327
    # A motion's variance along the normal, |m| (1 + cos 2 angle).
    amount = jnp.sqrt(kernel.along_u**2 + kernel.diagonal**2 + 1e-12)
    moved = (amount + swing) ** 2 / (variance * variance)
    box = (edge.normal_u**4 + edge.normal_v**4) / (2880 * variance * variance)
    kurtosis = (kernel.kurtosis + _LINE_KURTOSIS * kernel.line * moved) / 24 - box
    square = score * score
    third, fifth = square - 3, square * (square - 10) + 15
    series = score * (kurtosis * third + kernel.sixth / 720 * fifth)
    share = 0.5 * (1 + jax.lax.erf(score * 0.7071067811865476)) - density * series
    return Coverage(share / edge.unit, score, density, edge.normal_u, edge.normal_v)
