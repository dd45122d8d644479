"""The bundled pictures are those of Table 1's rig, and their truth is that of the demo's scene."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from simulation.camera_picture.render import render_sheet
from simulation.scenes import demo_scene
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import InputError
from trinoc.io import (
    demo_images,
    demo_paths,
    demo_pattern,
    demo_truth,
    load_scene_truth,
    save_scene_truth,
)
from trinoc.io.demo import demo_folder
from trinoc.io.images import read_image
from trinoc.synth import table1_rig
from trinoc.synth.truth import points_along, shown_parts_mm

RIG = table1_rig()
# `python benchmarks/render_pictures.py pov-sheet` made it.
POV_RAY = Path(__file__).parent / "pov_ray_sheet_left.png"


def test_the_package_stays_small():
    assert sum(path.stat().st_size for path in demo_folder().iterdir()) < 2_000_000


@pytest.mark.parametrize("kind", ["sheet", "scene"])
def test_pictures_are_there_for_each_view(kind):
    pictures = demo_images(kind)
    assert tuple(pictures) == RIG.names
    for picture in pictures.values():
        assert picture.shape == (480, 512)
        assert picture.dtype == np.uint8


def test_another_kind_is_refused():
    with pytest.raises(InputError, match="sheet"):
        demo_paths("table")


def test_the_sheet_is_the_default_pattern():
    pattern, default = demo_pattern(), Pattern.default()
    np.testing.assert_allclose(pattern.centres_mm, default.centres_mm)
    np.testing.assert_allclose(pattern.inner_radius_mm, default.inner_radius_mm)


def test_two_renderers_put_the_sheet_in_one_place():
    """Compare POV-Ray's picture and trinoc's by phase correlation of their enhanced edges."""
    view = "left"
    picture = read_image(POV_RAY).astype(np.float64)
    ours = render_sheet(demo_pattern(), RIG[view], bits=None)
    inside = np.zeros(picture.shape)
    corners = np.array([[-84.0, -84, 0, 1], [84, -84, 0, 1], [84, 84, 0, 1], [-84, 84, 0, 1]])
    u, v, w = RIG[view].matrix_px @ corners.T
    outline = np.stack([u / w, v / w], axis=1).round().astype(np.int32)
    cv2.fillConvexPoly(inside, outline, 1.0)
    inside = cv2.GaussianBlur(inside, (0, 0), 4.0)
    edges = [inside * cv2.Laplacian(cv2.GaussianBlur(p, (0, 0), 2.0), -1) for p in (picture, ours)]
    # Least squares for the shift between them: no grey level, only place, is compared.
    down, across = np.gradient(edges[1])
    system = np.stack([across.ravel(), down.ravel(), edges[1].ravel()], axis=1)
    solution = np.linalg.lstsq(system, edges[0].ravel(), rcond=None)[0]
    np.testing.assert_allclose(-solution[:2] / solution[2], 0.0, atol=0.01)


def test_the_truth_is_the_scene_s():
    truth, scene = demo_truth(), demo_scene()
    np.testing.assert_allclose(truth.edges_mm, scene.edges_mm, atol=1e-6)
    assert truth.edge_kinds == scene.edge_kinds
    for view, camera in RIG.items():
        parts, visible_edges = scene.seen_by(camera), truth.seen[view]
        for edge in range(len(scene.edges_mm)):
            visible = np.sum(np.diff(parts.extent[parts.segment == edge]))
            listed = np.sum(np.diff(visible_edges.extent[visible_edges.edge == edge]))
            assert listed == pytest.approx(visible, abs=1e-4)


def test_edges_step_the_way_the_truth_says():
    """Compare grey levels of the noisy pictures on both sides of long edges of strong contrast."""
    truth = demo_truth()
    for view, picture in demo_images("scene").items():
        visible_edges, camera = truth.seen[view], RIG[view]
        compared = 0
        for edge, extent, step in zip(
            visible_edges.edge, visible_edges.extent, visible_edges.grey_step, strict=True
        ):
            middle = np.linspace(extent[0], extent[1], 12)[3:-3]
            points = points_along(truth.edges_mm[[edge]], middle[None])[0]
            uv = points @ camera.matrix_px[:, :3].T + camera.matrix_px[:, 3]
            uv = uv[:, :2] / uv[:, 2:]
            along = uv[-1] - uv[0]
            if np.hypot(*along) < 12 or abs(step) < 30:
                continue
            left_normal = 2.0 * np.array([along[1], -along[0]]) / np.hypot(*along)
            levels = [
                picture[tuple(np.rint(uv + s * left_normal).astype(int).T[::-1])].mean()
                for s in (1, -1)
            ]
            assert np.sign(levels[0] - levels[1]) == np.sign(step)
            compared += 1
        assert compared >= 10


def test_truth_files_round_trip(tmp_path):
    truth = demo_truth()
    save_scene_truth(truth, tmp_path / "truth.json", {"seed": 3})
    loaded = load_scene_truth(tmp_path / "truth.json")
    np.testing.assert_array_equal(loaded.edges_mm, truth.edges_mm)
    assert loaded.edge_kinds == truth.edge_kinds
    np.testing.assert_array_equal(
        shown_parts_mm(loaded, grey_step=8.0), shown_parts_mm(truth, grey_step=8.0)
    )
