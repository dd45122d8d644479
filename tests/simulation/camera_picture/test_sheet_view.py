"""Pixels show the points of the print that project to them, however the sheet lies."""

import jax
import numpy as np
import pytest

from simulation.camera_picture.paper import Paper
from simulation.camera_picture.sheet_view import SheetView, cell_offsets_px, pixel_grid_px
from simulation.camera_picture.surfaces import ConePaper, RolledPaper, TwistedPaper
from tests.simulation.camera_picture.views import camera_of
from trinoc.geometry import project, sheet_from_pixel
from trinoc.geometry.intrinsics import Intrinsics

DISTORTED = Intrinsics(
    focal_length_px=(190.0, 230.0), image_size_px=(96, 90), distortion=(-0.3, 0.1, 2e-3, -1e-3)
)
PAPERS = {
    "flat": Paper(),
    "rolled and stretched": Paper(
        RolledPaper.from_sagitta(4.0, direction_deg=25.0), print_scale=(1.003, 0.998)
    ),
    "twisted cornet": Paper(TwistedPaper(ConePaper.from_sagitta(3.0), 0.5)),
}
VIEWS = {name: SheetView(camera_of(DISTORTED), paper) for name, paper in PAPERS.items()}
MARGIN_PX = 3


@pytest.mark.parametrize("view", VIEWS.values(), ids=VIEWS.keys())
def test_what_a_pixel_shows_projects_to_it(view):
    print_mm = view.centres_mm(MARGIN_PX).reshape(-1, 2)
    # Scale, surface and projection one after the other, without the view's own functions.
    paper_mm = print_mm * np.array(view.paper.print_scale)
    world = jax.jit(jax.vmap(view.paper.surface.point_world_mm))(paper_mm)
    image = jax.jit(jax.vmap(lambda point: project(view.camera, point)))(world)
    expected = pixel_grid_px(view.image_size_px, MARGIN_PX).reshape(-1, 2)
    np.testing.assert_allclose(image, expected, atol=1e-9)
    np.testing.assert_allclose(view.pixels_px(print_mm), expected, atol=1e-9)


@pytest.mark.parametrize("view", VIEWS.values(), ids=VIEWS.keys())
def test_cells_between_the_centres_are_as_exact(view):
    centres = view.centres_mm(MARGIN_PX)
    divided = np.array([[4, 4], [50, 70], [91, 3], [88, 95]])
    cells = view.cells_mm(centres, divided, 8)
    uv = (divided[:, ::-1] - MARGIN_PX)[:, None, None, :] + cell_offsets_px(8)
    image = view.pixels_px(cells.reshape(-1, 2)).reshape(uv.shape)
    # The cubic term that a quadratic leaves out, at half a pixel of such a wide view.
    np.testing.assert_allclose(image, uv, atol=5e-5)


def test_a_flat_sheet_is_seen_as_by_rays():
    view = VIEWS["flat"]
    uv = pixel_grid_px(view.image_size_px, 2).reshape(-1, 2)
    rays = jax.jit(jax.vmap(lambda pixel: sheet_from_pixel(view.camera, pixel)))(uv)
    np.testing.assert_allclose(view.centres_mm(2).reshape(-1, 2), rays, atol=1e-9)


def test_above_the_horizon_there_is_nothing():
    print_mm = SheetView(camera_of(tilt_deg=4.0), PAPERS["rolled and stretched"]).centres_mm(0)
    assert np.isnan(print_mm[0]).all()
    assert np.isfinite(print_mm[-1]).all()
