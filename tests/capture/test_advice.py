"""The advice about the next picture, for synthetic picture qualities."""

import pytest

from tests.capture.made import quality, rectangle
from trinoc.capture.advice import (
    adds_information,
    field_share,
    next_step,
    summary_lines,
)
from trinoc.capture.image_quality import quality_line

ALL = rectangle(0.01, 0.01, 0.99, 0.99)
LEANS = [(0.2, 0.0), (-0.2, 0.0), (0.0, 0.2), (0.0, -0.2), (0.0, 0.0), (0.0, 0.0)]


def test_one_begins_in_the_middle() -> None:
    assert "middle" in next_step([])


@pytest.mark.parametrize(
    ("missing", "region"),
    [
        ((0.5, 0.0, 1.0, 0.5), "the upper right corner"),
        ((0.0, 0.5, 0.5, 1.0), "the lower left corner"),
        ((0.0, 0.0, 0.3, 1.0), "left"),
        ((0.0, 0.6, 1.0, 1.0), "the lower"),
    ],
)
def test_the_emptiest_part_of_the_field_comes_next(missing, region) -> None:
    left, upper, right, lower = missing
    parts = [
        (0.01, 0.01, left - 0.02, 0.99),
        (right + 0.02, 0.01, 0.99, 0.99),
        (0.01, 0.01, 0.99, upper - 0.02),
        (0.01, lower + 0.02, 0.99, 0.99),
    ]
    shown = [quality(rectangle(*part)) for part in parts if part[0] < part[2] and part[1] < part[3]]
    assert region in next_step(shown)


def test_then_every_side_is_to_be_far_once_and_then_it_is_enough() -> None:
    shown = [quality(ALL)]
    sentences = []
    for lean in LEANS:
        sentences.append(next_step(shown))
        shown.append(quality(ALL, lean))
    for far, sentence in zip(("right", "left", "upper"), sentences):
        assert f"its {far} side farther" in sentence
    assert next_step(shown).startswith("Enough")
    assert "more" in next_step(shown[:5])


def test_what_is_wrong_with_the_last_comes_first_and_counts_for_nothing() -> None:
    lost = quality(ALL[:0], refusal="No sheet was found.")
    soft = quality(ALL, faults=("edges are 4.0 px wide: hold it still",))
    assert next_step([quality(ALL), lost]) == "Take it again: No sheet was found."
    assert "4.0 px" in next_step([soft])
    assert field_share([soft, lost]) == 0.0
    assert field_share([soft, quality(ALL)]) == 1.0
    assert (
        "1 good, 1 without the board found, 1 to take again"
        in summary_lines([soft, lost, quality(ALL)])[0]
    )
    assert quality_line(lost).startswith("made.png: NOT FOUND")
    assert quality_line(soft).startswith("made.png: AGAIN, 25 of 25 circles")


def test_a_picture_is_kept_for_a_new_cell_or_a_new_lean() -> None:
    first, same = quality(ALL), quality(ALL)
    assert adds_information([], first)
    assert not adds_information([first], same)
    assert adds_information([first], quality(ALL, (0.2, 0.0)))
    part = quality(rectangle(0.01, 0.01, 0.4, 0.4))
    assert adds_information([part], first)
    assert not adds_information([first], quality(ALL[:0], refusal="none"))


def test_a_name_of_several_lines_stays_one_line() -> None:
    assert "\n" not in quality_line(quality(ALL, name="a\nb.png"))
