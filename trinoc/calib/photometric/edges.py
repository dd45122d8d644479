"""The share of a blurred pixel that lies on the inked side of one edge.

An edge is F(X, Y) = 0 on the sheet, in mm, with ink where F < 0. Its image is a curve; what
counts is the distance of the pixel from the nearest point of that curve, its foot, and the
curvature there. Under a Gaussian of variance s^2 = blur^2 + 1/12 (the last is the pixel's
box) the coverage of a half plane is the normal distribution function; curvature adds a shift
and a widening, the box a small kurtosis.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.calib.photometric.sheet_places import Ray, SheetPoint, sheet_point
from trinoc.numerics.precision import ArrayLike

# Of one pixel or of many.
Scalar = Float[ArrayLike, "*n"]

# numerical: beyond so many sigmas the coverage is 0 or 1, and its series mean nothing.
_REACH = 6.0
_LEAST_VARIANCE = 0.01  # numerical: a guard of a division
_LINE_KURTOSIS = -1.2  # numerical: excess kurtosis of a line of even light
# numerical: guards that are met only far from an edge, where the expansions about it break down.
_NEAREST_TO_CENTRE, _LEAST_ROOT, _SURE_SHARE = 0.25, 0.1, 0.95


class Edge(NamedTuple):
    """How an edge looks from a pixel; held fixed when the model is linearised.

    Fields
    ------
    distance : of the pixel from the edge's image, positive outside the ink, px.
    gradient : g, length of the gradient of F with respect to the pixel at the foot, mm per px.
    normal_u, normal_v : N, its direction.
    normal_x, normal_y : n, the gradient of F on the sheet, of unit length.
    curvature : of the edge's image at the foot, positive where the ink bulges out, per px.
    curvature_change : second derivative of the curvature along the edge, per px^3.
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
    """An edge F = n . (X, Y) - offset, for a unit normal n."""
    value = normal_x * point.point_mm[0] + normal_y * point.point_mm[1] - offset_mm
    gradient, normal_u, normal_v = _gradient(point, normal_x, normal_y)
    slope_n, slope_t = _rotate_components(
        point.depth_slope[0], point.depth_slope[1], normal_u, normal_v
    )
    # The image is a straight line but for the lens: its distance, to third order.
    lens = _lens_bend(point, normal_x, normal_y, normal_u, normal_v, gradient)
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
    """An edge F = |(X, Y) - centre| - radius.

    The foot comes from the second-order expansion of F at the pixel; the edge is then looked
    at from there, because a steep ellipse bends much between a pixel and its foot.
    """
    normal_x, normal_y, centre_distance = _from_centre(point, centre_mm)
    gradient, normal_u, normal_v = _gradient(point, normal_x, normal_y)
    tangent_n, _ = _tangent(point, normal_x, normal_y, normal_u, normal_v)
    slope_n, _ = _rotate_components(point.depth_slope[0], point.depth_slope[1], normal_u, normal_v)
    far = jnp.maximum(centre_distance, _NEAREST_TO_CENTRE * radius_mm)
    lens = _lens_bend(point, normal_x, normal_y, normal_u, normal_v, gradient)
    bend = tangent_n * tangent_n / (far * gradient) - 2 * slope_n + lens.along_n
    value = centre_distance - radius_mm
    first = value / gradient
    root = jnp.sqrt(jnp.maximum(1 - 2 * bend * first, _LEAST_ROOT))
    step = 2 * first / (1 + root)
    shift_u, shift_v = -step * normal_u, -step * normal_v

    foot = sheet_point(sheet_from_camera, ray.move(shift_u, shift_v), point.unit)
    normal_x, normal_y, centre_distance = _from_centre(foot, centre_mm)
    gradient, normal_u, normal_v = _gradient(foot, normal_x, normal_y)
    tangent_n, tangent_t = _tangent(foot, normal_x, normal_y, normal_u, normal_v)
    curvature = tangent_t * tangent_t / (radius_mm * gradient)
    ratio = (15 * tangent_n * tangent_n - 3 * tangent_t * tangent_t) / (gradient * gradient)
    lens = _lens_bend(foot, normal_x, normal_y, normal_u, normal_v, gradient)
    change = curvature * tangent_t * tangent_t / (radius_mm * radius_mm) * (3 + ratio)
    curvature = curvature + lens.along_t
    outward, aside = _rotate_components(-shift_u, -shift_v, normal_u, normal_v)
    rest = (centre_distance - radius_mm) / gradient
    rounding = 0.5 * curvature * aside * aside / jnp.maximum(1 + curvature * outward, 0.5)
    # F grows by no more than the largest stretch of the picture: inside a steep ellipse,
    # where the foot may lie on either side, this keeps the distance from vanishing.
    (a00, a01), (a10, a11) = point.by_pixel
    squares, area = a00 * a00 + a01 * a01 + a10 * a10 + a11 * a11, a00 * a11 - a01 * a10
    flat = jnp.sqrt(jnp.maximum(squares * squares - 4 * area * area, 0.0))
    stretch = jnp.sqrt(0.5 * (squares + flat))
    least = _SURE_SHARE * jnp.abs(value) / stretch
    distance = outward + rest + rounding
    distance = jnp.where(value < 0, jnp.minimum(distance, -least), jnp.maximum(distance, least))
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
    """What blurs a picture, the pixel's box included; a Gaussian with one field alone.

    See `unknowns` for the fields. None is the value of an ideal camera, which the compiler leaves
    out.
    """

    sigma_px: Scalar
    kurtosis: Scalar | None = None
    sixth: Scalar | None = None
    along_u: Scalar | None = None
    diagonal: Scalar | None = None
    along_axes: Scalar | None = None
    line: Scalar | None = None


class EdgeCoverage(NamedTuple):
    """Coverage by one edge, with what its product with another edge needs."""

    share: Scalar
    score: Scalar
    density: Scalar
    normal_u: Scalar
    normal_v: Scalar


def coverage(edge: Edge, shift_mm: Scalar, kernel: Kernel) -> EdgeCoverage:
    """Share of the pixel with ink, where F has grown by `shift_mm`.

    A Gaussian whose width depends on the edge's direction, with cumulants beyond the second as in
    Edgeworth's series: flat-topped as a defocus disc or a moved picture.
    """
    variance, aside = _variances(edge, kernel)
    kurtosis = _kurtosis_term(edge, kernel, variance)
    if kernel.sixth is not None:
        # Divisions by one, for the derivatives' sake: see `SheetPoint.unit`.
        numbers = shift_mm, variance, aside, kurtosis
        shift_mm, variance, aside, kurtosis = (number / edge.unit for number in numbers)
    sigma = jnp.sqrt(variance)
    reach = _REACH * sigma
    distance = jnp.clip(edge.distance + shift_mm / edge.gradient, -reach, reach)
    half = jnp.clip(0.5 * edge.curvature * aside / sigma, -0.5, 0.5)
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
    """Of the kernel along the edge's normal, and along the edge."""
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
    """Excess kurtosis along the normal over 24, that of the pixel's box included."""
    box = (edge.normal_u**4 + edge.normal_v**4) / (2880 * variance * variance)
    if kernel.along_u is None or kernel.diagonal is None:
        return -box
    assert kernel.line is not None
    assert kernel.kurtosis is not None
    even, odd = _double_angle(edge)
    # A motion's variance along the normal, |m| (1 + cos 2 angle).
    amount = jnp.sqrt(kernel.along_u**2 + kernel.diagonal**2 + 1e-12)
    moved = amount + kernel.along_u * even + kernel.diagonal * odd
    of_line = _LINE_KURTOSIS * kernel.line * moved * moved / (variance * variance)
    return (kernel.kurtosis + of_line) / 24 - box


def _double_angle(edge: Edge) -> tuple[Scalar, Scalar]:
    """Cosine and sine of twice the angle of the edge's normal."""
    even = edge.normal_u * edge.normal_u - edge.normal_v * edge.normal_v
    return even, 2 * edge.normal_u * edge.normal_v


def common(first: EdgeCoverage, second: EdgeCoverage) -> Scalar:
    """Share of the pixel on the inked side of both edges.

    The two distances are normal variables correlated by the angle of the edges; the bivariate
    normal distribution function as its tetrachoric series, within the bounds that any two
    events keep: nearly parallel edges reach them, where the series fails.
    """
    rho = first.normal_u * second.normal_u + first.normal_v * second.normal_v
    p, q = first.score, second.score
    series = rho * (1 + rho * (p * q / 2 + rho * (p * p - 1) * (q * q - 1) / 6))
    both = first.share * second.share + first.density * second.density * series
    least = jnp.maximum(first.share + second.share - 1, 0.0)
    return jnp.clip(both, least, jnp.minimum(first.share, second.share))


def _from_centre(
    point: SheetPoint, centre_mm: Float[ArrayLike, "2 *n"]
) -> tuple[Scalar, Scalar, Scalar]:
    """Direction and distance of a point of the sheet from a circle's centre."""
    dx, dy = point.point_mm[0] - centre_mm[0], point.point_mm[1] - centre_mm[1]
    distance = jnp.sqrt(dx * dx + dy * dy + 1e-12)
    return dx / distance, dy / distance, distance


def _gradient(
    point: SheetPoint, normal_x: Scalar, normal_y: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    """Length and direction, in the picture, of the gradient of F."""
    (a00, a01), (a10, a11) = point.by_pixel
    u, v = normal_x * a00 + normal_y * a10, normal_x * a01 + normal_y * a11
    length = jnp.sqrt(u * u + v * v)
    return length, u / length, v / length


def _tangent(
    point: SheetPoint, normal_x: Scalar, normal_y: Scalar, normal_u: Scalar, normal_v: Scalar
) -> tuple[Scalar, Scalar]:
    """Motion along the edge on the sheet for a motion along N and along T in the picture."""
    (a00, a01), (a10, a11) = point.by_pixel
    u, v = -normal_y * a00 + normal_x * a10, -normal_y * a01 + normal_x * a11
    return _rotate_components(u, v, normal_u, normal_v)


class _LensBend(NamedTuple):
    """Second derivatives of F that the lens adds, over g: along N, along N and T, along T."""

    along_n: Scalar
    across: Scalar
    along_t: Scalar


def _lens_bend(
    point: SheetPoint,
    normal_x: Scalar,
    normal_y: Scalar,
    normal_u: Scalar,
    normal_v: Scalar,
    gradient: Scalar,
) -> _LensBend:
    if point.bend is None:
        zero = jnp.zeros_like(gradient)
        return _LensBend(zero, zero, zero)
    uu, uv, vv = (
        (normal_x * point.bend[0, k] + normal_y * point.bend[1, k]) / gradient for k in range(3)
    )
    square_u, both, square_v = normal_u * normal_u, normal_u * normal_v, normal_v * normal_v
    return _LensBend(
        uu * square_u + 2 * uv * both + vv * square_v,
        (vv - uu) * both + uv * (square_u - square_v),
        uu * square_v - 2 * uv * both + vv * square_u,
    )


def _rotate_components(
    u: Scalar, v: Scalar, normal_u: Scalar, normal_v: Scalar
) -> tuple[Scalar, Scalar]:
    """Components of (u, v) along N and along T, N turned by a quarter."""
    return u * normal_u + v * normal_v, v * normal_u - u * normal_v
