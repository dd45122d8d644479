"""Tables for a terminal and the comparison with known cameras."""

import dataclasses
import math

import numpy as np
import pytest

from trinoc.geometry.camera import Camera
from trinoc.geometry.rig import Rig
from trinoc.match.tracks.matches import Matches
from trinoc.report import counts_text, errors_text, parameter_errors, reasons_text
from trinoc.report.matches_part import reasons_by_view
from trinoc.report.report_table import text_table

from .conftest import PARAMETERS, TABLE_1


def _moved(rig: Rig) -> Rig:
    """The rig with the upper camera's pan changed by 0.0052 deg, four of its sigmas."""
    camera = rig["upper"]
    _, tilt, swing, distance = TABLE_1["upper"]
    moved = Camera.from_degrees(
        camera.intrinsics, pan_deg=2.1482, tilt_deg=tilt, swing_deg=swing, distance_mm=distance
    )
    cameras = {name: moved if name == "upper" else rig[name] for name in rig}
    return Rig(cameras, parameters=rig.parameters, covariance=rig.covariance)


def test_errors_are_found_minus_known_in_sigmas(rig: Rig) -> None:
    errors = parameter_errors(_moved(rig), rig)
    assert [(e.camera, e.parameter) for e in errors] == [(c, p) for c in rig for p in PARAMETERS]
    assert errors[0].error == pytest.approx(0.0052, abs=1e-9)
    assert errors[0].over_sigma == pytest.approx(4.0, abs=1e-6)
    np.testing.assert_allclose([e.error for e in errors[1:]], 0.0, atol=1e-9)
    text = errors_text(errors, "Table 1")
    assert "2.1482 ± 0.0013" in text
    assert "+4.0" in text


def test_an_unknown_sigma_is_no_number_of_sigmas(rig: Rig) -> None:
    without_sigmas = Rig(dict(rig.items()))
    errors = parameter_errors(without_sigmas, rig)
    assert all(math.isnan(error.over_sigma) for error in errors)
    assert "not known" in errors_text(errors, "Table 1")


def test_columns_are_aligned() -> None:
    lines = text_table(("name", "count"), [("a", "1"), ("long name", "1,000")]).splitlines()
    assert lines == ["name       count", "a              1", "long name  1,000"]


def test_reasons_add_up_and_numbers_in_them_do_not_count(matches: Matches) -> None:
    reasons = np.array(["ambiguous with 3", "ambiguous with 12", "matched", "outside"])
    changed = dataclasses.replace(matches, reasons=dict.fromkeys(matches.views, reasons))
    table = reasons_by_view(changed)
    assert list(table) == ["matched", "ambiguous with others", "outside"]
    for view in matches.views:
        assert sum(counts[view] for counts in table.values()) == len(reasons)
    assert reasons_text(changed).splitlines()[-1].split()[-4:] == ["segments", "4", "4", "4"]


def test_counts_of_steps_leave_out_what_the_reasons_say(matches: Matches) -> None:
    counts = {"candidate_pairs": 1200, "segments matched": 3}
    changed = dataclasses.replace(matches, counts=counts)
    assert counts_text(changed).splitlines()[1:] == ["candidate pairs  1,200"]
