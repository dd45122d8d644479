"""Calibrate fixed cameras from one picture each, and match line segments across them.

The names below are imported when they are first used, so that `import trinoc` is quick.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from trinoc import errors
    from trinoc.calib.bundle.refinement import refine
    from trinoc.calib.detection.search import detect_pattern
    from trinoc.calib.from_images import calibrate
    from trinoc.calib.from_points import calibrate_points
    from trinoc.calib.intrinsics.from_images import calibrate_intrinsics
    from trinoc.calib.rig_check.knocked import check_rig
    from trinoc.calib.targets.pattern import Pattern
    from trinoc.calib.uncertainty.propagation import epipolar_sigma, point_covariance
    from trinoc.calib.uncertainty.systematics import Systematics, with_systematics
    from trinoc.evaluation.evaluation import evaluate
    from trinoc.geometry.camera import Camera
    from trinoc.geometry.intrinsics import Intrinsics
    from trinoc.geometry.rig import Rig
    from trinoc.geometry.segments import Segments
    from trinoc.io.known_shape import load_shape
    from trinoc.io.matches_npz import load_matches
    from trinoc.io.pattern_json import load_pattern
    from trinoc.io.rig_json import load_rig
    from trinoc.io.saving import save
    from trinoc.io.segments_npz import load_segments
    from trinoc.match.matcher import match_segments
    from trinoc.match.tracks.matches import Matches
    from trinoc.segments.find import find_segments

__version__ = "0.1.0"

__all__ = [
    "Camera",
    "Intrinsics",
    "Matches",
    "Pattern",
    "Rig",
    "Segments",
    "Systematics",
    "calibrate",
    "calibrate_intrinsics",
    "calibrate_points",
    "check_rig",
    "detect_pattern",
    "epipolar_sigma",
    "errors",
    "evaluate",
    "find_segments",
    "load_matches",
    "load_pattern",
    "load_rig",
    "load_segments",
    "load_shape",
    "match_segments",
    "point_covariance",
    "refine",
    "save",
    "with_systematics",
]

_MODULE_OF = {
    "Camera": "trinoc.geometry.camera",
    "Intrinsics": "trinoc.geometry.intrinsics",
    "Matches": "trinoc.match.tracks.matches",
    "Pattern": "trinoc.calib.targets.pattern",
    "Rig": "trinoc.geometry.rig",
    "Segments": "trinoc.geometry.segments",
    "Systematics": "trinoc.calib.uncertainty.systematics",
    "calibrate": "trinoc.calib.from_images",
    "calibrate_intrinsics": "trinoc.calib.intrinsics.from_images",
    "calibrate_points": "trinoc.calib.from_points",
    "check_rig": "trinoc.calib.rig_check.knocked",
    "detect_pattern": "trinoc.calib.detection.search",
    "epipolar_sigma": "trinoc.calib.uncertainty.propagation",
    "evaluate": "trinoc.evaluation.evaluation",
    "find_segments": "trinoc.segments.find",
    "load_matches": "trinoc.io.matches_npz",
    "load_pattern": "trinoc.io.pattern_json",
    "load_rig": "trinoc.io.rig_json",
    "load_segments": "trinoc.io.segments_npz",
    "load_shape": "trinoc.io.known_shape",
    "match_segments": "trinoc.match.matcher",
    "point_covariance": "trinoc.calib.uncertainty.propagation",
    "refine": "trinoc.calib.bundle.refinement",
    "save": "trinoc.io.saving",
    "with_systematics": "trinoc.calib.uncertainty.systematics",
}


def __getattr__(name: str) -> object:
    if name == "errors":
        return importlib.import_module("trinoc.errors")
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'trinoc' has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
