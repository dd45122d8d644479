"""The page about a rig from many shots is complete and safe, and its figures are correct."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trinoc.calib import CalibrationResult, CameraFit, Detection, Status
from trinoc.calib.problem.views import BoardObservation
from trinoc.calib.result.halves import CrossValidation, FieldDifference, HalvesCheck
from trinoc.calib.targets.checkers import Chessboard
from trinoc.geometry.rig import Rig
from trinoc.report import write_report
from trinoc.report.checks import Level, Subject
from trinoc.report.coverage import Coverage, coverage_by_boards, mean_residuals, places_seen
from trinoc.report.field_part import FieldLevel, halves_maps, uncertainty_maps
from trinoc.report.html import render_report
from trinoc.report.numbers import with_sigma
from trinoc.report.shots_part import count_shots, shot_table
from trinoc.report.verdict import Verdict, find_verdict

from .conftest import made_up_rig
from .test_html import Page

BOARD = Chessboard(rows=4, columns=6, square_mm=20.0)
SHOTS = tuple(f"{number:02}" for number in range(12))
SIZE_PX = (512, 480)
HALVES = HalvesCheck(1.02, "left.fx", 1.1, 24)
MIDDLES = np.stack(np.meshgrid(*(np.linspace(50, side - 50, 5) for side in SIZE_PX)), -1)


def board_observation(
    camera: int, shot: int, random: np.random.Generator, *, used: bool = True
) -> BoardObservation:
    """A board upright in the image. The first shots place it in the corners."""
    corner = (
        np.array([(0, 0), (1, 0), (1, 1), (0, 1)][shot]) if shot < 4 else random.uniform(size=2)
    )
    spread = BOARD.centres_mm - BOARD.centres_mm.min(axis=0)
    centres = 8 + corner * (np.array(SIZE_PX) - 17 - spread.max(axis=0)) + spread
    count = len(BOARD)
    detection = Detection(
        circle_index=np.arange(count),
        centres_px=centres,
        covariance_px2=np.tile(0.01 * np.eye(2), (count, 1, 1)),
        shape_px2=np.full((count, 2, 2), np.nan),
        lines_px=np.full((2, 3), np.nan),
        image_size_px=SIZE_PX,
    )
    return BoardObservation(camera, shot, detection, np.full(count, used))


def made_up(**changes: Any) -> CalibrationResult:
    """Three cameras that saw twelve boards; `changes` replaces fields of the result.

    `status` is that of every camera, and `sigma_factor` goes into their fits.
    """
    random, rig = np.random.default_rng(5), made_up_rig()
    views = tuple(board_observation(k, s, random) for k in range(3) for s in range(len(SHOTS)))
    poses = np.tile(np.eye(3, 4), (len(SHOTS), 1, 1))
    poses[:, :, 3] = random.uniform(-60, 60, (len(SHOTS), 3))
    fields: dict[str, Any] = {
        "solution": rig,
        "parameters": (*rig.parameters, "board.scale_x"),
        "values": np.append(np.arange(12.0), 0.001),
        "covariance": np.diag(np.append(np.diag(rig.covariance), 4e-8)),
        "gauge": (),
        "world": "the board in 00",
        "target": BOARD,
        "shots": SHOTS,
        "world_from_board": poses,
        "reference_from_board": np.eye(3, 4)[None],
        "place_shifts_mm": np.zeros((0, 3)),
        "views": views,
        "residuals_px": tuple(random.normal(0, 0.1, (len(BOARD), 2)) for _ in views),
        "reduced_chi_square": 1.0,
        "halves": HALVES,
        "failures": {},
        "refused": (),
        "systematics": ("print size (0.2 %)",),
        "notes": (),
    }
    status: Status = changes.pop("status", Status.CONVERGED)
    factors = {**dict.fromkeys(rig.names, 1.0), **changes.pop("sigma_factor", {})}
    fields = {**fields, **changes}
    fits = {}
    for number, name in enumerate(rig.names):
        rows = [k for k, view in enumerate(fields["views"]) if view.camera == number]
        residuals = [np.zeros((0, 2)), *(fields["residuals_px"][k] for k in rows)]
        used = [np.zeros(0, dtype=bool), *(fields["views"][k].rows_used for k in rows)]
        fits[name] = CameraFit(
            np.concatenate(residuals),
            np.concatenate(used),
            4,
            1.0,
            sigma_factor=factors[name],
        )
    return CalibrationResult(status=dict.fromkeys(rig.names, status), fits=fits, **fields)


def verdict_of(result: CalibrationResult) -> Verdict:
    board_views = places_seen(result)
    verdict = find_verdict(
        Subject(
            shots=result,
            coverage=coverage_by_boards(board_views),
            residuals=mean_residuals(board_views)[0],
            uncertainty=uncertainty_maps(result),
        )
    )
    assert verdict is not None
    return verdict


def covered(result: CalibrationResult) -> tuple[Coverage, ...]:
    return coverage_by_boards(places_seen(result))


@pytest.fixture(scope="module")
def result() -> CalibrationResult:
    return made_up()


def test_every_camera_parameter_and_shot_is_shown_and_nothing_is_fetched(result) -> None:
    page = Page(render_report(result=result))
    for word in (*result.cameras, *SHOTS, "pan (deg)", "scale_x", "print size (0.2 %)"):
        assert word in page.text
    assert {"cameras", "shots", "field-of-board", "uncertainty", "space"} <= set(
        page.attributes("id")
    )
    assert not page.attributes("src")
    assert all(link.startswith(("#", "data:")) for link in page.attributes("href"))
    assert page.text.count("You can use this rig.") == 1


def test_equal_results_give_equal_files(result, tmp_path: Path) -> None:
    write_report(tmp_path / "a.html", result=result)
    write_report(tmp_path / "b.html", result=made_up())
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_names_cannot_break_the_page(result) -> None:
    shots = ("<script>alert(1)</script>", *SHOTS[1:])
    text = render_report(
        result=made_up(shots=shots, notes=("<b>bold</b>",), failures={'left, "><i>': "no <board>"})
    )
    page = Page(text)
    assert "<script>alert(1)</script>" in page.text
    assert "no <board>" in page.text
    assert "<i>" not in text


def test_a_fit_that_failed_shows_its_shots_and_no_rig() -> None:
    page = Page(render_report(result=made_up(solution=None, status=Status.NOT_CONVERGED)))
    assert "Do not rely on this rig." in page.text
    assert not {"space", "uncertainty"} & set(page.attributes("id"))
    assert "shots" in page.attributes("id")


@pytest.mark.parametrize(
    ("changes", "level", "sentence"),
    [
        ({}, Level.GOOD, "px"),
        ({"gauge": ("left.pan_deg",)}, Level.BAD, "left.pan_deg"),
        ({"status": Status.SUSPECT, "notes": ("Another lens.",)}, Level.BAD, "Another lens."),
        ({"halves": HALVES._replace(ratio=2.0)}, Level.CARE, "2.00 claimed sigmas"),
        ({"halves": HALVES._replace(ratio=9.0)}, Level.BAD, "9.00 claimed sigmas"),
        ({"halves": None}, Level.CARE, "does not determine"),
        ({"sigma_factor": {"upper": 1.0, "right": 5.0, "left": 1.0}}, Level.CARE, "in right"),
    ],
)
def test_the_verdict_is_that_of_the_worst_check(changes, level, sentence) -> None:
    verdict = verdict_of(made_up(**changes))
    assert verdict.level is level
    assert sentence in f"{verdict.reason} {' '.join(check.figure for check in verdict.checks)}"


def test_pictures_are_counted_by_what_became_of_them(result) -> None:
    views = (result.views[0]._replace(used=np.zeros(len(BOARD), bool)), *result.views[1:])
    table = shot_table(made_up(views=views, failures={"left, 99": "too dark"}))
    roles = ("used", "left-out", "missing", "none")
    assert [count_shots(table, role) for role in roles] == [35, 1, 1, 2]
    assert verdict_of(made_up(views=views, refused=("00: moved.",))).level is Level.CARE


def test_a_board_in_all_corners_covers_the_picture(result) -> None:
    assert all(field.share > 0.9 for field in covered(result))
    middle = tuple(view for view in result.views if view.shot >= 4)
    errors = tuple(e for v, e in zip(result.views, result.residuals_px, strict=True) if v.shot >= 4)
    fewer = covered(made_up(views=middle, residuals_px=errors))
    assert all(a.share < b.share for a, b in zip(fewer, covered(result), strict=True))


def test_mean_residuals_tell_a_pattern_from_chance(result) -> None:
    by_chance, _ = mean_residuals(places_seen(result))
    assert np.mean([field.over_chance**2 for field in by_chance]) == pytest.approx(1, abs=0.3)
    shift = np.array([0.3, -0.1])
    moved = tuple(errors + shift for errors in result.residuals_px)
    fields, scale = mean_residuals(places_seen(made_up(residuals_px=moved)))
    for field in fields:
        assert field.over_chance > 3
        arrows = np.array([np.array(m.tip) - (m.u, m.v) for m in field.means]) / scale.times
        np.testing.assert_allclose(arrows.mean(axis=0), shift, atol=0.02)


def test_what_shots_held_out_and_the_next_one_say_is_shown(result) -> None:
    text = render_report(
        result=made_up(cross_validation=CrossValidation(12, {"left": 0.1}, {"left": 0.234})),
        advice="Show the board to left & right.",
    )
    assert "0.234 px" in Page(text).text
    assert "To take next: Show the board to left & right." in Page(text).text
    assert "To take next" not in render_report(result=result)


def test_the_halves_are_compared_over_the_field(result) -> None:
    difference = np.full((2, 25, 2), [0.03, 0.04])
    difference[1, 3] = np.nan
    sigma, distances_mm = np.full((2, 25), 0.01), np.array([512.0, 1536.0])
    fields = tuple(
        FieldDifference(name, distances_mm, MIDDLES.reshape(-1, 2), difference, sigma)
        for name in result.cameras
    )
    with_maps = made_up(halves=HALVES._replace(over_field=fields))
    near_maps, far_maps = halves_maps(with_maps)
    assert [each.name for each in near_maps] == list(result.cameras)
    assert {(cell.text, cell.below) for cell in near_maps[0].cells} == {
        ("0.05", "3.5 \N{GREEK SMALL LETTER SIGMA}")
    }
    assert far_maps[0].cells[3].description == "no ray of the lens"
    page = Page(render_report(result=with_maps))
    for word in ("512 mm away, 3.54 sigmas rms", "1536 mm away", "Two halves"):
        assert word in page.text
    assert "halves" in page.attributes("id")
    assert "halves" not in Page(render_report(result=result)).attributes("id")


def test_the_maps_grow_as_the_sigmas_of_the_rig(result) -> None:
    maps = uncertainty_maps(result)
    assert maps is not None
    wider = made_up(
        solution=Rig(
            dict(result.rig.items()),
            parameters=result.rig.parameters,
            covariance=4 * result.rig.covariance,
        )
    )
    doubled = uncertainty_maps(wider)
    assert doubled is not None
    for wide, level in zip(doubled.levels, maps.levels, strict=True):
        assert (wide.name, wide.stands) == (level.name, level.stands)
    assert [level.name.split()[0] for level in maps.levels if level.stands] == ["1", "3"]
    assert doubled.at_boards.median_px == pytest.approx(2 * maps.at_boards.median_px)
    assert doubled.at_boards.worst_px == pytest.approx(2 * maps.at_boards.worst_px)
    assert doubled.worst_farther_px == pytest.approx(2 * maps.worst_farther_px)


def test_one_statement_says_how_well_a_pixel_is_known(result) -> None:
    """The board's size apart: the cameras' distances share its error, and the maps have none."""
    parameters, share = result.parameters, 2e-3
    response = np.array(
        [1.0 if name == "board.scale_x" else 0.0 for name in parameters]
        )  # fmt: skip
    response += [
        result.rig[name.partition(".")[0]].distance_mm if name.endswith("distance_mm") else 0.0
        for name in parameters
    ]
    noise = np.diag(np.append(np.diag(result.rig.covariance), 0.0))
    covariance = noise + share**2 * np.outer(response, response)
    rig = Rig(
        dict(result.rig.items()),
        parameters=result.rig.parameters,
        covariance=covariance[:-1, :-1],
    )
    sized, exact = made_up(solution=rig, covariance=covariance), made_up(covariance=noise)
    now, before = sized.pixel_sigma, exact.pixel_sigma
    assert now is not None
    assert before is not None
    assert before.size_px == 0.0
    assert "board's size" not in before.sentence
    assert now.median_px == pytest.approx(before.median_px, rel=1e-6)
    assert now.worst_px == pytest.approx(before.worst_px, rel=1e-6)
    # A point at some radius moves by the share of it: nowhere more than at the corner.
    assert 0.2 * share * 350.0 < now.size_px < 2.0 * share * 350.0
    maps, same = uncertainty_maps(sized), uncertainty_maps(exact)
    assert maps is not None
    assert same is not None
    for one, other in zip(maps.levels, same.levels, strict=True):
        assert texts_of(one) == texts_of(other)
    text = Page(render_report(result=sized)).text
    assert text.count(f"adds up to {now.size_px:.2g} px") >= 2
    assert f"± {now.median_px:.2g} px" in text
    assert now.sentence in sized.summary()


def test_pairs_of_cameras_stand_in_report_summary_and_record(result) -> None:
    from trinoc.cli.calibrate_rig import rig_record

    page, record = Page(render_report(result=result)), rig_record(result)
    assert "How the cameras stand to each other" in page.text
    assert [pair["cameras"] for pair in record["pairs"]] == [
        ["upper", "right"],
        ["upper", "left"],
        ["right", "left"],
    ]
    for pair in result.pairs:
        assert f"{pair.first}, {pair.second}" in page.text
        assert with_sigma(pair.baseline_mm, pair.baseline_sigma_mm) in page.text
    lines = [line for line in result.summary().splitlines() if ": baseline " in line]
    assert [line.partition(":")[0] for line in lines] == ["upper to right", "upper to left"]
    without_covariance = made_up(solution=None, status=Status.NOT_CONVERGED)
    assert rig_record(without_covariance)["pairs"] == []
    assert "stand to each other" not in render_report(result=without_covariance)


def texts_of(level: FieldLevel) -> list[list[str]]:
    """The numbers of the maps of one distance."""
    return [[cell.text for cell in field_map.cells] for field_map in level.maps]
