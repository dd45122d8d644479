"""Plain pictures of sheets: area, centre and energy are those of the geometry."""

import jax
import numpy as np
import pytest

from simulation.camera_picture.layers import cover_card
from simulation.camera_picture.light import Illumination
from simulation.camera_picture.render import render_sheet
from tests.geometry.conics import image_of_circle, shape_of_dual_conic
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry import project
from trinoc.geometry.camera import Camera
from trinoc.geometry.image_of_circle import image_of_circle_centre
from trinoc.geometry.intrinsics import Intrinsics

LENS = Intrinsics(focal_length_px=(410.0, 500.0), image_size_px=(160, 150))
PAPER, INK = 230.0, 25.0


def camera_of(lens=LENS, pan=-20.0, tilt=45.0, swing=3.0):
    return Camera.from_degrees(
        lens, pan_deg=pan, tilt_deg=tilt, swing_deg=swing, distance_mm=470.0, aim_mm=(1.3, -2.1)
    )


def one_disc(inner=0.0):
    return Pattern.cross_grid(
        rows=1, columns=1, pitch_mm=40.0, radius_mm=12.0, line_width_mm=0.0,
        rings=np.array([[inner > 0]]), inner_radius_mm=inner or None,
    )  # fmt: skip


def clean(pattern, camera, **options):
    return render_sheet(pattern, camera, paper=PAPER, ink=INK, bits=None, **options)


def darkness_moments(picture):
    """Area in pixels and centroid (u, v) of the ink."""
    ink = (PAPER - picture) / (PAPER - INK)
    rows, columns = np.indices(picture.shape)
    return ink.sum(), np.array([(ink * columns).sum(), (ink * rows).sum()]) / ink.sum()


# Below this blur the pixels under-sample the picture, and a sum over them is no integral.
@pytest.mark.parametrize("blur_px", [0.7, 2.0])
@pytest.mark.parametrize("inner", [0.0, 5.0])
def test_area_and_centroid_of_a_disc_and_a_ring_are_the_ellipses(blur_px, inner):
    camera = camera_of()
    ellipses = []
    for radius in (12.0, inner):
        dual = image_of_circle(camera, np.zeros(2), np.asarray(radius))
        shape = np.asarray(shape_of_dual_conic(dual)) if radius else np.zeros((2, 2))
        centre = np.asarray(image_of_circle_centre(camera, np.zeros(2), np.asarray(radius)))
        ellipses.append((np.pi * np.sqrt(max(np.linalg.det(shape), 0.0)), centre))
    (outer_area, outer_centre), (inner_area, inner_centre) = ellipses
    area = outer_area - inner_area
    centre = (outer_area * outer_centre - inner_area * inner_centre) / area
    found_area, found_centre = darkness_moments(clean(one_disc(inner), camera, blur_px=blur_px))
    assert found_area == pytest.approx(area, rel=2e-5)
    np.testing.assert_allclose(found_centre, centre, atol=2e-5)


def test_the_centroid_follows_a_lens_with_distortion():
    lens = Intrinsics(
        focal_length_px=(410.0, 500.0), image_size_px=(160, 150),
        distortion=(-0.4, 0.1, 1e-3, -2e-3, 0.0),
    )  # fmt: skip
    camera = camera_of(lens)
    # The centroid of a curved patch: the mean of the images of its points, by the area each
    # has on the picture.
    r, a = np.meshgrid((np.arange(60) + 0.5) / 60 * 12.0, np.arange(120) * np.pi / 60)
    points = np.stack([r * np.cos(a), r * np.sin(a)], -1).reshape(-1, 2)

    points = np.column_stack([points, np.zeros(len(points))])
    images = np.asarray(jax.jit(jax.vmap(project, (None, 0)))(camera, points))
    jacobian = jax.jit(jax.vmap(jax.jacfwd(project, 1), (None, 0)))(camera, points)
    jacobian = np.asarray(jacobian)
    weight = np.abs(np.linalg.det(jacobian[:, :, :2])) * r.reshape(-1)
    expected = (weight[:, None] * images).sum(0) / weight.sum()
    _, centroid = darkness_moments(clean(one_disc(), camera))
    np.testing.assert_allclose(centroid, expected, atol=1e-3)


def test_blur_keeps_the_energy_and_widens_the_edge():
    sharp, soft = (clean(one_disc(), camera_of(), blur_px=b) for b in (0.2, 1.5))
    assert sharp.sum() == pytest.approx(soft.sum(), rel=1e-7)
    assert np.abs(np.diff(sharp, axis=0)).max() > np.abs(np.diff(soft, axis=0)).max()
    assert soft.min() > INK - 1e-6
    assert soft.max() < PAPER + 1e-6


def test_finer_cells_change_next_to_nothing():
    pattern = Pattern.cross_grid(rows=2, columns=2, pitch_mm=16.0, radius_mm=5.0)
    coarse, fine = (clean(pattern, camera_of(), supersampling=s) for s in (8, 24))
    # What is left comes from the ends of the lines, where two edges share a cell.
    assert np.sqrt(np.mean((coarse - fine) ** 2)) < 0.03


def grey_at(picture, camera, x, y):
    u, v = np.rint(np.asarray(project(camera, np.array([x, y, 0.0])))).astype(int)
    return picture[v, u]


@pytest.mark.parametrize(
    ("style", "inside", "before"),
    [("stop", INK, PAPER), ("through", INK, INK), ("white", PAPER, INK)],
)
def test_line_styles(style, inside, before):
    pattern = Pattern.cross_grid(
        rows=1, columns=3, pitch_mm=20.0, radius_mm=5.0, rings="none", line_width_mm=3.0,
        line_half_length_mm=(35.0, 20.0), line_style=style, line_gap_mm=3.0,
    )  # fmt: skip
    camera = camera_of(Intrinsics(focal_length_px=(900.0, 1000.0), image_size_px=(300, 300)))
    picture = clean(pattern, camera, blur_px=0.3)
    assert grey_at(picture, camera, 20.0, 0.0) == pytest.approx(inside, abs=0.5)
    assert grey_at(picture, camera, 26.5, 0.0) == pytest.approx(before, abs=0.5)
    assert grey_at(picture, camera, 10.0, 0.0) == pytest.approx(INK, abs=0.5)
    assert grey_at(picture, camera, 10.0, 8.0) == pytest.approx(PAPER, abs=0.5)


def test_grey_levels_are_rounded_and_scaled_and_noise_has_its_sigma():
    camera, pattern = camera_of(), one_disc()
    light = clean(pattern, camera, covers=(cover_card((0.0, 0.0), grey=300.0),))
    settings = {"paper": PAPER, "ink": INK, "covers": (cover_card((0.0, 0.0), grey=300.0),)}
    for bits, dtype in ((8, np.uint8), (16, np.uint16)):
        picture = render_sheet(pattern, camera, **settings, bits=bits)
        assert picture.dtype == dtype
        expected = np.rint(np.clip(light, 0, 255) * (2**bits - 1) / 255)
        assert np.abs(picture - expected).max() <= 1
    first, repeated, other = (
        render_sheet(pattern, camera, paper=128.0, ink=128.0, noise_sigma=3.0, seed=s, bits=16)
        for s in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, repeated)
    assert not np.array_equal(first, other)
    # The sigma of an estimated sigma is sigma / sqrt(2 n).
    assert (first / 257.0).std() == pytest.approx(3.0, abs=5 * 3.0 / np.sqrt(2 * first.size))


def test_what_covers_and_lights_changes_what_it_should():
    camera, pattern = camera_of(), one_disc()
    plain = clean(pattern, camera)
    covered = clean(pattern, camera, covers=(cover_card((0.0, 0.0), turn_deg=30, grey=150.0),))
    assert grey_at(covered, camera, 1, 1) == pytest.approx(150.0)
    lit = clean(pattern, camera, light=Illumination(slope=(1.0, 0.0)))
    assert grey_at(lit, camera, -25, 0) < grey_at(plain, camera, -25, 0) < lit.max()
    on_table = clean(pattern, camera, table=80.0)
    assert grey_at(on_table, camera, 25, 0) == pytest.approx(PAPER)
