"""Residuals on the images of shots: the lines are exact, and the page stays small."""

import re

import numpy as np
import pytest

from trinoc.report.html import render_report
from trinoc.report.shot_images_part import MOST_SHOTS, shot_images_part

from .test_html import Page
from .test_shots import BOARD, SHOTS, SIZE_PX, made_up


def lines_of(path: str) -> tuple[np.ndarray, np.ndarray]:
    """Start points (n, 2) and steps (n, 2) of the lines of an SVG path."""
    numbers = np.array(re.findall(r"M(\S+) (\S+)l(\S+) (\S+?)(?=M|$)", path), dtype=float)
    numbers = numbers.reshape(-1, 4)
    return numbers[:, :2], numbers[:, 2:]


def pictures(read: list[tuple[str, str]]) -> dict:
    def reader(camera: str, shot: str):
        def image() -> np.ndarray:
            read.append((camera, shot))
            return np.full((SIZE_PX[1], SIZE_PX[0]), 128, np.uint8)

        return image

    return {
        camera: {shot: reader(camera, shot) for shot in SHOTS}
        for camera in ("upper", "right", "left")
    }


def test_lines_are_the_residuals_magnified_from_where_each_place_was_found() -> None:
    result = made_up()
    part = shot_images_part(result, None)
    assert part is not None
    assert part.pictures == []
    times = float(part.times)
    for number, camera in enumerate(part.cameras):
        assert camera.name == result.cameras[number]
        assert camera.caption == "all 12 shots, the largest residuals first"
        for figure in camera.figures:
            (row,) = [
                k
                for k, view in enumerate(result.views)
                if (view.camera, result.shots[view.shot]) == (number, figure.name)
            ]
            start, step = lines_of(figure.residuals)
            np.testing.assert_allclose(start, result.views[row].detection.centres_px, atol=0.051)
            np.testing.assert_allclose(step / times, result.residuals_px[row], atol=0.06 / times)
            assert figure.left_out == figure.residuals_left_out == ""


def test_the_largest_come_first_and_no_more_than_twelve_are_read() -> None:
    result = made_up()
    errors = list(result.residuals_px)
    # The shots of the second half of a camera are bad, one more than the others.
    for row, view in enumerate(result.views):
        errors[row] = errors[row] * (1.0 + view.shot)
    views = (*result.views, *(v._replace(shot=v.shot + 12) for v in result.views if v.camera == 0))
    errors += [0.01 * e for v, e in zip(result.views, errors, strict=True) if v.camera == 0]
    more = made_up(
        views=views,
        residuals_px=tuple(errors),
        shots=(*SHOTS, *(f"{shot} b" for shot in SHOTS)),
        world_from_board=np.tile(result.world_from_board, (2, 1, 1)),
    )
    read: list[tuple[str, str]] = []
    part = shot_images_part(more, pictures(read))
    assert part is not None
    first = part.cameras[0]
    assert first.caption == "the 12 of 24 shots with the largest residuals, the largest first"
    rms_px = [float(figure.caption.split()[0]) for figure in first.figures]
    assert rms_px == sorted(rms_px, reverse=True)
    assert len(first.figures) == MOST_SHOTS
    assert {shot for camera, shot in read if camera == "upper"} == set(SHOTS)
    assert len(read) == 36


def test_places_left_out_are_marked_and_cut() -> None:
    result = made_up()
    errors = [np.array(each) for each in result.residuals_px]
    errors[0][3] = (80.0, 0.0)
    views = list(result.views)
    used = np.arange(len(BOARD)) != 3
    views[0] = views[0]._replace(used=used)
    views[1] = views[1]._replace(used=np.zeros(len(BOARD), dtype=bool))
    changed = made_up(views=tuple(views), residuals_px=tuple(errors))
    part = shot_images_part(changed, None)
    assert part is not None
    assert part.any_left_out
    # The longest residual is that of the first shot.
    figure = part.cameras[0].figures[0]
    assert figure.name == SHOTS[0]
    assert figure.caption.endswith("px rms, 1 left out")
    _, step = lines_of(figure.residuals_left_out)
    assert step.tolist() == [[pytest.approx(0.2 * SIZE_PX[0], abs=0.1), 0.0]]
    (left_out_figure,) = [each for each in part.cameras[0].figures if each.name == SHOTS[1]]
    assert left_out_figure.caption.startswith("left out, ")
    assert left_out_figure.residuals == ""
    assert "located wrongly and left out" in Page(render_report(result=changed)).text


def test_the_page_holds_each_image_once_and_small() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (1536, 2048, 3)).astype(np.uint8)
    result = made_up()
    images = {name: dict.fromkeys(SHOTS, noise) for name in result.cameras}
    text = render_report(result=result, shot_pictures=images)
    bare = render_report(result=result)
    assert text.count("data:image/jpeg") == 36
    assert bare.count("data:image/jpeg") == 0
    # Noise is the largest that a JPEG can be.
    assert len(text) - len(bare) < 36 * 150_000
    page = Page(text)
    assert "shot-images" in page.attributes("id")
    assert "drawn" in page.text


def test_detections_in_place_of_images_are_drawn_on_grey() -> None:
    result = made_up()
    images = {name: dict.fromkeys(SHOTS, result.views[0].detection) for name in result.cameras}
    part = shot_images_part(result, images)
    assert part is not None
    assert part.pictures == []
