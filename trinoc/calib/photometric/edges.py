"""Coverage of a blurred pixel by one edge of ink: the share of its light from the inked side.

An edge is the curve F(X, Y) = 0 on the sheet, in mm, with ink where F < 0. The foot of a pixel is
the nearest point of the edge's image. The coverage depends on the distance d to the foot and on the
curvature there. For a straight edge and Gaussian blur it is Phi(-d / s), with s^2 = blur^2 + 1/12
(the integration over the pixel). Curvature adds a shift and a widening, the square pixel a small
kurtosis.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.calib.photometric.sheet_geometry import Ray, SheetPoint, sheet_point
from trinoc.numerics.precision import ArrayLike

# A number for one pixel or for many.
Scalar = Float[ArrayLike, "*n"]

# numerical: distance in sigmas beyond which the coverage is 0 or 1 and its series is not valid.
_REACH = 6.0
_LEAST_VARIANCE = 0.01  # numerical: guard of a division
_LINE_KURTOSIS = -1.2  # numerical: excess kurtosis of a uniform distribution on a line
# numerical: guards that act only far from an edge, where the expansions are not valid.
_NEAREST_TO_CENTRE, _LEAST_ROOT, _SURE_SHARE = 0.25, 0.1, 0.95


class Edge(NamedTuple):
    """Geometry of an edge of ink relative to a pixel. Derivatives treat it as constant.

    The edge is the curve F(X, Y) = 0 on the sheet, with ink where F < 0 (mm). Its foot is the point
    of the edge's image that is nearest to the pixel.

    Attributes
    ----------
    distance : distance of the pixel from the edge's image, positive outside the ink, px.
    gradient : length g of the derivative of F with respect to the pixel coordinates at the foot, mm
        per px.
    normal_u, normal_v : unit vector N of this derivative in the image.
    normal_x, normal_y : unit vector n of the gradient of F on the sheet.
    curvature : curvature of the edge's image at the foot, positive for convex ink, 1/px.
    curvature_change : second derivative of the curvature with respect to the length along the edge,
        1/px^3.
    unit : 1 (see `SheetPoint`).
    """

    distance: Scalar
    gradient: Scalar
    normal_u: Scalar
    normal_v: Scalar
    normal_x: Scalar
    normal_y: Scalar
    curvature: Scalar
    curvature_change: Scalar
    unit: Scalar


def straight_edge(
    point: SheetPoint, normal_x: Scalar, normal_y: Scalar, offset_mm: Float[ArrayLike, "*#n"]
) -> Edge:
    """Geometry of a straight edge, F = n . (X, Y) - offset.

    Parameters
    ----------
    point : point of the sheet under each pixel.
    normal_x, normal_y : unit normal n on the sheet, pointing away from the ink.
    offset_mm : signed distance of the edge from the sheet's origin along n.
    """
    value = normal_x * point.point_mm[0] + normal_y * point.point_mm[1] - offset_mm
    gradient, normal_u, normal_v = _gradient(point, normal_x, normal_y)
    slope_n, slope_t = _rotate_components(
        point.depth_slope[0], point.depth_slope[1], normal_u, normal_v
    )
    # Distance to third order. Without distortion the image is a straight line.
    lens = _lens_curvature(point, normal_x, normal_y, normal_u, normal_v, gradient)
    along_n, across = lens.along_n - 2 * slope_n, lens.across - slope_t
    first = value / gradient
    distance = (
        first
        + 0.5 * first * first * along_n
        + 0.5 * first**3 * (along_n * along_n - across * across)
    )
    return Edge(
        distance,
        gradient,
        normal_u,
        normal_v,
        normal_x,
        normal_y,
        lens.along_t,
        jnp.zeros_like(gradient),
        point.unit,
    )


def circular_edge(
    sheet_from_camera: Float[ArrayLike, "3 3"],
    ray: Ray,
    point: SheetPoint,
    centre_mm: Float[ArrayLike, "2 *n"],
    radius_mm: Scalar,
) -> Edge:
    """Geometry of a circular edge, F = |(X, Y) - centre| - radius.

    F is expanded to second order at the pixel to find the foot. The geometry is then evaluated at
    the foot, because the curvature of an oblique circle's image varies strongly.

    Parameters
    ----------
    sheet_from_camera : homography from rays in the camera frame to the sheet.
    ray, point : ray of each pixel, and the point of the sheet under each pixel.
    centre_mm, radius_mm : centre and radius of the circle on the sheet.
    """
    normal_x, normal_y, centre_distance = _from_centre(point, centre_mm)
    gradient, normal_u, normal_v = _gradient(point, normal_x, normal_y)
    tangent_n, _ = _tangent(point, normal_x, normal_y, normal_u, normal_v)
    slope_n, _ = _rotate_components(point.depth_slope[0], point.depth_slope[1], normal_u, normal_v)
    far = jnp.maximum(centre_distance, _NEAREST_TO_CENTRE * radius_mm)
    lens = _lens_curvature(point, normal_x, normal_y, normal_u, normal_v, gradient)
    second_along_n = tangent_n * tangent_n / (far * gradient) - 2 * slope_n + lens.along_n
    value = centre_distance - radius_mm
    first = value / gradient
    root = jnp.sqrt(jnp.maximum(1 - 2 * second_along_n * first, _LEAST_ROOT))
    step = 2 * first / (1 + root)
    shift_u, shift_v = -step * normal_u, -step * normal_v

    foot = sheet_point(sheet_from_camera, ray.move(shift_u, shift_v), point.unit)
    normal_x, normal_y, centre_distance = _from_centre(foot, centre_mm)
    gradient, normal_u, normal_v = _gradient(foot, normal_x, normal_y)
    tangent_n, tangent_t = _tangent(foot, normal_x, normal_y, normal_u, normal_v)
    curvature = tangent_t * tangent_t / (radius_mm * gradient)
    ratio = (15 * tangent_n * tangent_n - 3 * tangent_t * tangent_t) / (gradient * gradient)
    lens = _lens_curvature(foot, normal_x, normal_y, normal_u, normal_v, gradient)
    change = curvature * tangent_t * tangent_t / (radius_mm * radius_mm) * (3 + ratio)
    curvature = curvature + lens.along_t
    outward, sideways = _rotate_components(-shift_u, -shift_v, normal_u, normal_v)
    remaining = (centre_distance - radius_mm) / gradient
    rounding = 0.5 * curvature * sideways * sideways / jnp.maximum(1 + curvature * outward, 0.5)
    # The largest stretch of the mapping bounds the slope of F. Inside an oblique ellipse, where the
    # foot may lie on either side, this keeps the distance from vanishing.
    (a00, a01), (a10, a11) = point.by_pixel
    squares, area = a00 * a00 + a01 * a01 + a10 * a10 + a11 * a11, a00 * a11 - a01 * a10
    flat = jnp.sqrt(jnp.maximum(squares * squares - 4 * area * area, 0.0))
    stretch = jnp.sqrt(0.5 * (squares + flat))
    lower_bound = _SURE_SHARE * jnp.abs(value) / stretch
    distance = outward + remaining + rounding
    distance = jnp.where(
        value < 0, jnp.minimum(distance, -lower_bound), jnp.maximum(distance, lower_bound)
    )
    return Edge(
        distance,
        gradient,
        normal_u,
        normal_v,
        normal_x,
        normal_y,
        curvature,
        change,
        point.unit,
    )


class Kernel(NamedTuple):
    """Blur kernel of an image, including the integration over the square pixel.

    With `sigma_px` alone the kernel is a Gaussian. A field that is None has the value of an ideal
    camera, and the compiler omits its terms.

    Attributes
    ----------
    sigma_px : rms width along one axis, mean over all directions.
    kurtosis, sixth : fourth and sixth cumulant divided by powers of the width; 0 for a Gaussian.
    along_u : (variance along u - variance along v) / 2, px^2.
    diagonal : covariance of u and v, px^2.
    along_axes : half the variance along the image axes minus half that along the diagonals, px^2.
    line : shape of the anisotropic part: 1 for a straight motion, 0 for a Gaussian.
    """

    sigma_px: Scalar
    kurtosis: Scalar | None = None
    sixth: Scalar | None = None
    along_u: Scalar | None = None
    diagonal: Scalar | None = None
    along_axes: Scalar | None = None
    line: Scalar | None = None


class EdgeCoverage(NamedTuple):
    """Share of a pixel that is on the inked side of one edge.

    Attributes
    ----------
    share : share of the pixel's light that comes from the inked side, 0 to 1.
    score : argument z of the normal distribution function; without higher cumulants the share is
        Phi(z).
    density : standard normal density at `score`.
    normal_u, normal_v : unit normal of the edge in the image.
    """

    share: Scalar
    score: Scalar
    density: Scalar
    normal_u: Scalar
    normal_v: Scalar


def coverage(edge: Edge, shift_mm: Scalar, kernel: Kernel) -> EdgeCoverage:
    """Share of a pixel that is on the inked side of an edge.

    The kernel is a Gaussian whose width depends on the direction of the edge. Higher cumulants
    enter as in Edgeworth's series; they describe the flat top of defocus and of motion blur.

    Parameters
    ----------
    edge : geometry of the edge.
    shift_mm : displacement of the edge toward its ink; negative if the ink spreads.
    kernel : blur kernel.
    """
    variance, along_variance = _variances(edge, kernel)
    kurtosis = _kurtosis_term(edge, kernel, variance)
    if kernel.sixth is not None:
        # Divisions by one keep the compiler from recomputing values: see `SheetPoint.unit`.
        numbers = shift_mm, variance, along_variance, kurtosis
        shift_mm, variance, along_variance, kurtosis = (number / edge.unit for number in numbers)
    sigma = jnp.sqrt(variance)
    reach = _REACH * sigma
    distance = jnp.clip(edge.distance + shift_mm / edge.gradient, -reach, reach)
    half = jnp.clip(0.5 * edge.curvature * along_variance / sigma, -0.5, 0.5)
    shift = half + 3 * half**3 + edge.curvature_change * sigma**3 / 8
    score = -(distance / sigma + shift) / jnp.sqrt(1 + 2 * half * half)
    density = jnp.exp(-0.5 * score * score) * 0.3989422804014327
    square = score * score
    series = kurtosis * (square - 3)
    if kernel.sixth is not None:
        series = series + kernel.sixth / 720 * (square * (square - 10) + 15)
    share = 0.5 * (1 + jax.lax.erf(score * 0.7071067811865476)) - density * score * series
    if kernel.sixth is not None:
        score, density = score / edge.unit, density / edge.unit
    return EdgeCoverage(share / edge.unit, score, density, edge.normal_u, edge.normal_v)


def _variances(edge: Edge, kernel: Kernel) -> tuple[Scalar, Scalar]:
    """Variances of the kernel along the edge's normal and along the edge, px^2."""
    middle = kernel.sigma_px * kernel.sigma_px
    if kernel.along_u is None or kernel.diagonal is None or kernel.along_axes is None:
        return middle, middle
    even, odd = _double_angle(edge)
    swing = kernel.along_u * even + kernel.diagonal * odd
    middle = middle + kernel.along_axes * (even * even - odd * odd)
    return jnp.maximum(middle + swing, _LEAST_VARIANCE), jnp.maximum(
        middle - swing, _LEAST_VARIANCE
    )


def _kurtosis_term(edge: Edge, kernel: Kernel, variance: Scalar) -> Scalar:
    """Excess kurtosis of the kernel along the edge's normal, divided by 24.

    The kurtosis of the square pixel is included.
    """
    box = (edge.normal_u**4 + edge.normal_v**4) / (2880 * variance * variance)
    if kernel.along_u is None or kernel.diagonal is None:
        return -box
    assert kernel.line is not None
    assert kernel.kurtosis is not None
    even, odd = _double_angle(edge)
    # Variance of a straight motion along the normal, |m| (1 + cos 2 angle).
    amount = jnp.sqrt(kernel.along_u**2 + kernel.diagonal**2 + 1e-12)
    moved = amount + kernel.along_u * even + kernel.diagonal * odd
    of_line = _LINE_KURTOSIS * kernel.line * moved * moved / (variance * variance)
    return (kernel.kurtosis + of_line) / 24 - box


def _double_angle(edge: Edge) -> tuple[Scalar, Scalar]:
    """Cosine and sine of twice the angle between the edge's normal and the u axis."""
    even = edge.normal_u * edge.normal_u - edge.normal_v * edge.normal_v
    return even, 2 * edge.normal_u * edge.normal_v


def coverage_of_both(first: EdgeCoverage, second: EdgeCoverage) -> Scalar:
    """Share of the pixel that is on the inked side of both edges.

    The distances of a random point of the kernel from both edges have a bivariate normal
    distribution. Their correlation is the cosine of the angle between the edges' normals. The
    distribution function is evaluated by its tetrachoric series. The result is clipped to the
    Frechet bounds, because the series fails for nearly parallel edges.
    """
    rho = first.normal_u * second.normal_u + first.normal_v * second.normal_v
    p, q = first.score, second.score
    series = rho * (1 + rho * (p * q / 2 + rho * (p * p - 1) * (q * q - 1) / 6))
    both = first.share * second.share + first.density * second.density * series
    lower_bound = jnp.maximum(first.share + second.share - 1, 0.0)
    return jnp.clip(both, lower_bound, jnp.minimum(first.share, second.share))


def _from_centre(
    point: SheetPoint, centre_mm: Float[ArrayLike, "2 *n"]
) -> tuple[Scalar, Scalar, Scalar]:
    """Unit vector (x, y) from a circle's centre to a point of the sheet, and their distance, mm."""
    dx, dy = point.point_mm[0] - centre_mm[0], point.point_mm[1] - centre_mm[1]
    distance = jnp.sqrt(dx * dx + dy * dy + 1e-12)
    return dx / distance, dy / distance, distance


def _gradient(
    point: SheetPoint, normal_x: Scalar, normal_y: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    """Gradient of F, the distance from the edge on the sheet, with respect to pixel coordinates.

    Returns its length, mm per px, and its unit vector (u, v).

    normal_x, normal_y : gradient of F with respect to the sheet's coordinates, a unit vector.
    """
    (a00, a01), (a10, a11) = point.by_pixel
    u, v = normal_x * a00 + normal_y * a10, normal_x * a01 + normal_y * a11
    length = jnp.sqrt(u * u + v * v)
    return length, u / length, v / length


def _tangent(
    point: SheetPoint, normal_x: Scalar, normal_y: Scalar, normal_u: Scalar, normal_v: Scalar
) -> tuple[Scalar, Scalar]:
    """Movement along the edge on the sheet, mm, per pixel of movement in the image.

    The first value is for a movement along the image normal N of the edge, the second along its
    tangent T.
    """
    (a00, a01), (a10, a11) = point.by_pixel
    u, v = -normal_y * a00 + normal_x * a10, -normal_y * a01 + normal_x * a11
    return _rotate_components(u, v, normal_u, normal_v)


class _LensCurvature(NamedTuple):
    """Second derivatives of F that lens distortion causes, relative to the length of F's gradient.

    F is the distance from the edge on the sheet, mm; the derivatives are with respect to pixel
    coordinates. The fields are the derivatives along the edge's normal N twice, along N and the
    tangent T, and along T twice.
    """

    along_n: Scalar
    across: Scalar
    along_t: Scalar


def _lens_curvature(
    point: SheetPoint,
    normal_x: Scalar,
    normal_y: Scalar,
    normal_u: Scalar,
    normal_v: Scalar,
    gradient: Scalar,
) -> _LensCurvature:
    if point.second_by_pixel is None:
        zero = jnp.zeros_like(gradient)
        return _LensCurvature(zero, zero, zero)
    uu, uv, vv = (
        (normal_x * point.second_by_pixel[0, k] + normal_y * point.second_by_pixel[1, k]) / gradient
        for k in range(3)
    )
    square_u, both, square_v = normal_u * normal_u, normal_u * normal_v, normal_v * normal_v
    return _LensCurvature(
        uu * square_u + 2 * uv * both + vv * square_v,
        (vv - uu) * both + uv * (square_u - square_v),
        uu * square_v - 2 * uv * both + vv * square_u,
    )


def _rotate_components(
    u: Scalar, v: Scalar, normal_u: Scalar, normal_v: Scalar
) -> tuple[Scalar, Scalar]:
    """Components of an image vector (u, v) along the edge's normal N and its tangent T.

    T is N rotated by 90 degrees from u toward v.
    """
    return u * normal_u + v * normal_v, v * normal_u - u * normal_v
