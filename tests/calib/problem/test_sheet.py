"""A sheet bends without stretching: lengths along its surface are those of the drawing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from simulation.camera_picture.surfaces import ConePaper, RolledPaper
from trinoc.calib.problem.sheet import BentPaper, WarpedBoard

REACH_MM = 80.0
PAPER = BentPaper(np.array(REACH_MM))
BOARD = WarpedBoard(np.array([[90.0, 70.0]]))
# Positions on a sheet, mm: the corners are farther from the origin than REACH_MM.
PLACES_MM = np.stack(np.meshgrid(np.linspace(-70, 70, 5), np.linspace(-60, 60, 4)), -1).reshape(
    -1, 2
)
X_MM, Y_MM = np.array([1.0, 0.0]), np.array([0.0, 1.0])


def paper_shape(**heights_mm: float) -> np.ndarray:
    """Shape parameters of a `BentPaper` of true size with these coefficients of its height."""
    return np.array([heights_mm.get(name, 0.0) for name in BentPaper.names])


def point_of(model, shape):
    return jax.vmap(lambda xy: model.point(jnp.append(xy, 0.0), shape))


def stretch(model, shape, direction: np.ndarray) -> np.ndarray:
    """Stretch of the bent sheet along a direction: length over drawn length, less one."""

    def derivative(xy):
        point = jnp.append(xy, 0.0)
        along = jnp.append(direction, 0.0)
        return jax.jvp(lambda p: model.point(p, shape), (point,), (along,))[1]

    return np.linalg.norm(np.asarray(jax.vmap(derivative)(PLACES_MM)), axis=1) - 1


def largest_slope(model, shape) -> float:
    def height(xy):
        return model.point(jnp.append(xy, 0.0), shape)[2]

    return float(np.abs(np.asarray(jax.vmap(jax.jacfwd(height))(jnp.asarray(PLACES_MM)))).max())


# For each model: bends along X alone, and the same turned to Y, in mm.
BENDS = {
    "board": (BOARD, np.array([0.0, 0.0, 2.0, 0.0]), np.array([0.0, 0.0, 0.0, 2.0])),
    "paper": (
        PAPER,
        paper_shape(XX=2.0, XXX=-1.0, XXXX=0.5),
        paper_shape(YY=2.0, YYY=-1.0, YYYY=0.5),
    ),
}


@pytest.mark.parametrize("model", BENDS)
def test_a_bend_along_one_axis_keeps_lengths_along_it_and_positions_across_it(model) -> None:
    sheet, along_x, along_y = BENDS[model]
    for shape, direction, across in ((along_x, X_MM, 1), (along_y, Y_MM, 0)):
        moved = np.asarray(point_of(sheet, shape)(PLACES_MM))
        np.testing.assert_allclose(moved[:, across], PLACES_MM[:, across], atol=1e-12)
        # The remaining stretch is of fourth order in the slopes.
        slope = largest_slope(sheet, shape)
        assert slope > 0.03
        assert np.abs(stretch(sheet, shape, direction)).max() < 10 * slope**4
        assert np.abs(stretch(sheet, shape, X_MM if across == 0 else Y_MM)).max() < 1e-12


def test_parts_of_all_degrees_shorten_paper_by_half_the_integral_of_its_squared_slope() -> None:
    """For a bend along X alone the displacement is that integral from the origin, to rounding."""
    height = np.polynomial.Polynomial([0.0, 0.0, 2.0, -1.0, 0.5])
    x = PLACES_MM[:, 0] / REACH_MM
    expected = -0.5 * (height.deriv() ** 2).integ()(x) / REACH_MM
    moved = np.asarray(point_of(PAPER, paper_shape(XX=2.0, XXX=-1.0, XXXX=0.5))(PLACES_MM))
    np.testing.assert_allclose(moved[:, 0] - PLACES_MM[:, 0], expected, rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize("direction_deg", [0.0, 30.0, 90.0, 135.0])
def test_paper_rolled_in_any_direction_lies_where_the_arc_of_a_circle_does(direction_deg) -> None:
    rolled = RolledPaper.from_sagitta(2.0, direction_deg=direction_deg)
    cos, sin = np.cos(np.radians(direction_deg)), np.sin(np.radians(direction_deg))
    second = 0.5 * float(rolled.curvature_per_mm) * REACH_MM**2
    fourth = -(float(rolled.curvature_per_mm) ** 3) * REACH_MM**4 / 24
    shape = paper_shape(
        XX=second * cos**2, XY=2 * second * cos * sin, YY=second * sin**2,
        XXXX=fourth * cos**4, XXXY=4 * fourth * cos**3 * sin, XXYY=6 * fourth * cos**2 * sin**2,
        XYYY=4 * fourth * cos * sin**3, YYYY=fourth * sin**4,
    )  # fmt: skip
    expected = np.asarray(jax.vmap(rolled.point_world_mm)(PLACES_MM))
    np.testing.assert_allclose(point_of(PAPER, shape)(PLACES_MM), expected, atol=5e-5)
    # Both would agree on a sheet that nothing shortens.
    assert np.linalg.norm(expected[:, :2] - PLACES_MM, axis=1).max() > 0.01


def test_a_cornet_is_shortened_by_all_degrees_of_its_height_together() -> None:
    """Displacements by products of terms of unequal degree agree with the exact cone."""
    cone = ConePaper.from_sagitta(2.0, apex_mm=200.0, direction_deg=25.0)

    def height(xy):
        return cone.point_world_mm(xy)[2]

    taylor, shape, derivative = {}, {}, height
    for degree in range(1, 5):
        derivative = jax.jacfwd(derivative)
        taylor[degree] = np.asarray(derivative(jnp.zeros(2)))
    for term in BentPaper.height_terms:
        index = tuple(0 if letter == "X" else 1 for letter in term)
        factorials = np.prod([np.prod(range(1, term.count(axis) + 1)) for axis in "XY"])
        shape[term] = taylor[len(term)][index] / factorials * REACH_MM ** len(term)
    inner_mm = PLACES_MM[np.linalg.norm(PLACES_MM, axis=1) < 60]
    expected = np.asarray(jax.vmap(cone.point_world_mm)(inner_mm))
    moved = np.asarray(point_of(PAPER, paper_shape(**shape))(inner_mm))
    aside = np.abs(expected[:, :2] - inner_mm).max()
    assert np.abs(moved - expected)[:, :2].max() < 0.03 * aside
    of_second_degree = {term: shape[term] for term in ("XX", "YY", "XY")}
    coarse = np.asarray(point_of(PAPER, paper_shape(**of_second_degree))(inner_mm))
    assert np.abs(coarse - expected)[:, :2].max() > 0.05 * aside


@pytest.mark.parametrize("sheet", [BOARD, PAPER], ids=["board", "paper"])
def test_straight_lines_through_the_origin_keep_their_length_whatever_the_bend(sheet) -> None:
    shape = paper_shape(XX=1.5, YY=-1.0, XY=0.7) if sheet is PAPER else np.array([0, 0, 1.5, -1.0])

    def radial(xy):
        line = jnp.append(xy / jnp.linalg.norm(xy), 0.0)
        point = jnp.append(xy, 0.0)
        return jnp.linalg.norm(jax.jvp(lambda p: sheet.point(p, shape), (point,), (line,))[1])

    np.testing.assert_allclose(jax.vmap(radial)(PLACES_MM), 1.0, atol=2e-6)


def test_print_scale_stretches_a_flat_sheet_and_nothing_else_does() -> None:
    shape = paper_shape()
    shape[:3] = 2e-3, 1e-3, -1e-3
    expected = PLACES_MM * [1.003, 1.001]
    moved = np.asarray(point_of(PAPER, shape)(PLACES_MM))
    np.testing.assert_allclose(moved[:, :2], expected, rtol=1e-12)
    np.testing.assert_array_equal(moved[:, 2], 0.0)
