"""Epipolar lines on the page are those of the rig, whatever its lenses."""

import json
import re

import jax
import numpy as np
import pytest

from trinoc.geometry import AbstractLens, project
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.kannala_brandt import KannalaBrandt
from trinoc.geometry.lenses.polynomial import BrownConrady, Pinhole, Rational
from trinoc.geometry.rig import Rig
from trinoc.numerics.precision import in_float64
from trinoc.report.epipolar_part import EpipolarPart, epipolar_part
from trinoc.report.html import render_report
from trinoc.report.pictures import page_picture

from .browser import chromium, needs_chromium
from .conftest import made_up_matches, made_up_rig

PLACE = (420.0, 430.0, 260.0, 236.0)
LENSES = {
    "pinhole": Pinhole.from_parameters(np.array(PLACE)),
    "Brown-Conrady": BrownConrady.from_parameters(
        np.array([*PLACE, -0.25, 0.1, 0.001, -0.0005, 0.0])
    ),
    "rational": Rational.from_parameters(
        np.array([*PLACE, 0.4, 0.1, 0.001, -0.001, 0.02, 0.6, 0.15, 0.03])
    ),
    "fisheye": KannalaBrandt.from_parameters(
        np.array([230.0, 232.0, 260.0, 236.0, -0.02, 0.01, -0.004, 0.0006])
    ),
}


def rig_with(lens: AbstractLens) -> Rig:
    return Rig(
        {
            name: Camera(Intrinsics.of_lens(lens, (512, 480)), camera.pose)
            for name, camera in made_up_rig().items()
        }
    )


@in_float64
def pixels(rig: Rig) -> np.ndarray:
    """Images of points all over the field, (n, v, 2) px."""
    points = np.random.default_rng(4).uniform((-70, -70, -30), (70, 70, 30), (9, 3))
    views_px = [jax.vmap(project, in_axes=(None, 0))(camera, points) for _, camera in rig.items()]
    return np.stack([np.asarray(view) for view in views_px], axis=1)


def drawn(rig: Rig) -> EpipolarPart:
    pictures = {
        name: page_picture(name, None, camera.image_size_px) for name, camera in rig.items()
    }
    part = epipolar_part("scene", "ends", rig, pixels(rig), pictures)
    assert part is not None
    return part


def distance_px(point: np.ndarray, curve: np.ndarray) -> float:
    """Distance in px from a point to the nearest stroke of a curve."""
    start, strokes = curve[:-1], np.diff(curve, axis=0)
    share = np.clip(
        ((point - start) * strokes).sum(1) / np.maximum((strokes**2).sum(1), 1e-12), 0, 1
    )
    return float(np.linalg.norm(start + share[:, None] * strokes - point, axis=1).min())


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_every_curve_runs_through_its_point(lens: AbstractLens) -> None:
    part = drawn(rig_with(lens))
    assert part.largest_px < 1e-9
    for figure in part.figures:
        assert len(figure.curves) == 2 * len(figure.marks)
        for number, curve in enumerate(figure.curves):
            mark = figure.marks[number % len(figure.marks)]
            assert mark.colour == curve.colour
            assert distance_px(np.array([mark.u, mark.v]), curve.points_px) < 0.1


@needs_chromium
def test_a_click_draws_the_line_of_its_point_through_any_lens(tmp_path) -> None:
    rig = rig_with(LENSES["fisheye"])
    _, matches = made_up_matches(rig)
    page = tmp_path / "page.html"
    page.write_text(render_report(rig=rig, matches=matches), encoding="utf-8")
    with chromium() as driver:
        driver.get(page.as_uri())
        # Every mark of the first picture is clicked; what the second then draws is read.
        marks = driver.execute_script("""
            const [from, to] = document.querySelectorAll('svg[data-epipolar="scene"]');
            return [...from.querySelectorAll('.mark')].map((mark, k) => {
              const box = mark.getBoundingClientRect();
              from.dispatchEvent(new MouseEvent('click', {
                bubbles: true, clientX: box.x + box.width / 2, clientY: box.y + box.height / 2}));
              const partner = to.querySelectorAll('.mark')[k];
              return [partner.getAttribute('cx'), partner.getAttribute('cy'),
                      to.querySelector('.clicked path').getAttribute('d')];
            });""")
    assert len(marks) > 3, json.dumps(marks)
    for u, v, path_data in marks:
        segments = np.array(
            re.findall(r"M([^ML ]+) ([^ML ]+)L([^ML ]+) ([^ML ]+)", path_data), dtype=float
        )
        point = np.array([float(u), float(v)])
        nearest = min(distance_px(point, stroke.reshape(2, 2)) for stroke in segments)
        # A dot on the screen is a third of a pixel.
        assert nearest < 1.0
