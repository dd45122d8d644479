"""The worst check decides the verdict, and every check that is not good has a remedy."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trinoc.calib import CalibrationResult, Status, point_covariance
from trinoc.geometry.rig import Rig
from trinoc.match.tracks.matches import SUSPECT_SETS, Matches, MatchStatus
from trinoc.match.tracks.reliability import assess_matches
from trinoc.match.tuning.tracks import DecoyTuning, TrackTuning
from trinoc.report.checks import Level, Subject
from trinoc.report.coverage import Coverage, coverage_by_circles
from trinoc.report.field_part import FieldPart, field_part
from trinoc.report.matches_part import HEIGHT, LETTER, place_labels
from trinoc.report.pictures import PagePicture, Window
from trinoc.report.verdict import (
    CHECKS,
    LEVEL_OF_STATUS,
    QUESTION_ON_MATCHES,
    Verdict,
    find_verdict,
)


@pytest.fixture(scope="module")
def pictures(rig: Rig) -> dict[str, PagePicture]:
    return {name: PagePicture(name, *camera.image_size_px, "") for name, camera in rig.items()}


@pytest.fixture(scope="module")
def coverage(result: CalibrationResult, pictures: dict[str, PagePicture]) -> tuple[Coverage, ...]:
    return coverage_by_circles(result, pictures)


@pytest.fixture(scope="module")
def field(result: CalibrationResult, pictures: dict[str, PagePicture]) -> FieldPart:
    part = field_part(result.rig, result.pattern, None, pictures)
    assert part is not None
    return part


def verdict_of(**fields: Any) -> Verdict:
    verdict = find_verdict(Subject(**fields))
    assert verdict is not None
    return verdict


def test_a_good_calibration_is_decided_by_how_well_a_place_is_known(
    result: CalibrationResult, coverage: tuple[Coverage, ...], field: FieldPart
) -> None:
    verdict = verdict_of(result=result, coverage=coverage, field=field)
    assert verdict.level is Level.GOOD
    assert verdict.sentence == "You can use this rig."
    assert verdict.reason.startswith("± ")
    assert all(check.remedy for check in verdict.checks if check.level is not Level.GOOD)


def test_a_suspect_camera_decides_in_the_words_of_its_note(result: CalibrationResult) -> None:
    status = {**result.status, "left": Status.SUSPECT}
    verdict = verdict_of(result=dataclasses.replace(result, status=status))
    assert verdict.level is Level.BAD
    assert "2 of 3 cameras calibrated: left: suspect. Circle 7 was left out" in verdict.reason


@pytest.mark.parametrize("why", ["Its residuals are a swirl.", ""], ids=["why", "a file without"])
def test_matches_of_a_rig_that_was_doubted_ask_for_care(matches: Matches, why: str) -> None:
    assert verdict_of(matches=matches).level is Level.GOOD
    verdict = verdict_of(matches=matches, doubts={"upper": why})
    assert verdict.sentence == "Use these matches with care."
    assert f"SUSPECT. {why}".rstrip() in verdict.reason


def test_residuals_beyond_noise_ask_for_care_and_then_are_bad(result: CalibrationResult) -> None:
    for chi_square, level in ((1.9, Level.GOOD), (2.1, Level.CARE), (9.1, Level.BAD)):
        fit = dataclasses.replace(result.fits["right"], reduced_chi_square=chi_square)
        worse = dataclasses.replace(result, fits={**result.fits, "right": fit})
        (check,) = [
            c for c in verdict_of(result=worse).checks if c.question.startswith("Do the residuals")
        ]
        assert check.level is level
        assert "right" in check.explanation or chi_square < 1.03


def test_views_that_disagree_ask_for_a_check_of_the_rig(matches: Matches) -> None:
    verdict = verdict_of(matches=dataclasses.replace(matches, noise_scale=2.5))
    assert verdict.level is Level.CARE
    assert verdict.reason.startswith("2.50 times")
    assert any("trinoc check" in check.remedy for check in verdict.checks)


def test_a_set_that_does_not_belong_to_its_rig_decides_in_the_words_of_its_note(
    matches: Matches,
) -> None:
    notes, counts = ("Most likely they are exchanged.",), matches.counts | {SUSPECT_SETS: 1}
    verdict = verdict_of(matches=dataclasses.replace(matches, notes=notes, counts=counts))
    assert verdict.level is Level.BAD
    assert verdict.reason == "SUSPECT: Most likely they are exchanged."


def test_the_page_has_the_verdict_of_the_matches_and_every_finding(matches: Matches) -> None:
    changes = {
        MatchStatus.MATCHED: {},
        MatchStatus.UNCERTAIN: {"posterior": np.full(len(matches), 0.6)},
        MatchStatus.SUSPECT: {"counts": {SUSPECT_SETS: 1}, "notes": ("Exchanged.",)},
    }
    for status, change in changes.items():
        changed = dataclasses.replace(matches, **change)
        assessment = assess_matches(changed)
        assert assessment.status is changed.status is status
        verdict = verdict_of(matches=changed)
        assert (verdict.sentence, verdict.level) == (status.value, LEVEL_OF_STATUS[status])
        assert verdict.reason == assessment.deciding.reason
        rows = [(check.figure, check.explanation, check.remedy) for check in verdict.checks]
        assert rows == [(f.figure, f.explanation, f.remedy) for f in assessment.findings]


def test_coverage_is_the_share_that_the_circles_surround(
    result: CalibrationResult, coverage: tuple[Coverage, ...]
) -> None:
    for figure in coverage:
        inside = figure.places_px
        low, high = inside.min(axis=0), inside.max(axis=0)
        box = np.prod(high - low) / np.prod(result.rig[figure.name].image_size_px)
        assert 0.4 * box < figure.share < box
    for share, level in ((0.101, Level.GOOD), (0.099, Level.CARE)):
        covered = tuple(figure._replace(share=share) for figure in coverage)
        assert verdict_of(result=result, coverage=covered).level is level


def test_the_maps_show_what_the_library_says(
    result: CalibrationResult, field: FieldPart, rig: Rig
) -> None:
    low, high = (level for level in field.planes if level.stands)
    (low,) = low.maps
    assert low.name == "Z = 0 mm"
    sigmas = []
    for cell, (u, v) in ((low.cells[k], low.middles[k]) for k in (3, 12)):
        covariance = point_covariance(rig, np.array([u, -v, 0.0]))
        sigmas.append(float(np.sqrt(np.linalg.eigvalsh(covariance)[-1])))
        shown = float(cell.text) * (1e-3 if "µm" in low.caption else 1)
        assert shown == pytest.approx(sigmas[-1], abs=5e-5)
    # In the middle, where all axes meet, nothing is wrong by the sigmas of four parameters.
    assert field.worst_mm >= sigmas[0] > 10 * sigmas[1]
    # Above and below what the rig looks at, all is less well known; worst_mm is of what stands.
    corners = [float(level.maps[0].cells[0].text) for level in field.planes]
    assert corners[0] > corners[field.planes.index(high)] < corners[-1]
    heights = [
        float(level.name.split()[2].replace("\N{MINUS SIGN}", "-")) for level in field.planes
    ]
    assert heights == sorted(heights)
    assert len(field.pictures) == len(rig)
    assert all(0 <= cell.shade <= 1 for map_ in field.pictures for cell in map_.cells)
    assert max(cell.shade for map_ in field.pictures for cell in map_.cells) == 1


def test_a_rig_without_errors_has_no_maps(rig: Rig, pictures: dict[str, PagePicture]) -> None:
    without_sigmas = Rig(dict(rig.items()))
    assert field_part(without_sigmas, None, None, pictures) is None


def test_the_docs_say_every_limit() -> None:
    page = (Path(__file__).parents[2] / "docs" / "report.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| ") and "? |" in line]
    assert len(rows) == len(CHECKS) + len(QUESTION_ON_MATCHES)
    numbers = {
        "rig": "", "set": "SUSPECT",
        "count": f"{TrackTuning.min_sure_lines} ",
        "agreement": f"{DecoyTuning.noisy_above:g} times",
        "uncertainty": f"{100 * TrackTuning.max_sigma_of_scene:g} %",
    }  # fmt: skip
    for topic, (question, _) in QUESTION_ON_MATCHES.items():
        (line,) = (line for line in rows if line.startswith(f"| {question} |"))
        assert numbers[topic] in line
    for row in CHECKS:
        rows_of_check = [line for line in rows if line.startswith(f"| {row.question} |")]
        assert rows_of_check, row.question
        limits = [x for x in (row.good, row.bad) if x is not None and 0 < x < np.inf]
        limit_texts = [
            f"{100 * x:.0f} %" if row.at_least else f"{x:.2g}".removeprefix("0") for x in limits
        ]
        assert any(all(text in line for text in limit_texts) for line in rows_of_check), (
            row.question,
            limit_texts,
        )


def test_labels_stand_beside_their_lines_and_not_on_each_other() -> None:
    window = Window(-0.5, -0.5, 512, 480)
    random = np.random.default_rng(5)
    first = random.uniform(40, 440, size=(60, 2))
    lines = np.stack([first, first + random.normal(scale=25, size=(60, 2))], axis=1)
    labels = place_labels([str(k) for k in range(60)], lines, window)
    assert 20 < len(labels) <= 60
    boxes = np.array([(p.u, p.v, len(p.text) * LETTER / 2, HEIGHT / 2) for p in labels])
    for row, (u, v, width, height) in enumerate(boxes):
        others = np.delete(boxes, row, axis=0)
        is_separate = (abs(others[:, 0] - u) >= others[:, 2] + width - 1e-9) | (
            abs(others[:, 1] - v) >= others[:, 3] + height - 1e-9
        )
        assert is_separate.all()
