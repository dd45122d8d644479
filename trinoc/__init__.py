"""Calibrate fixed cameras from one picture each, and match line segments across them.

The names below are imported when they are first used, so that `import trinoc` is quick.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from trinoc import errors
    from trinoc.calib.calibrate import calibrate
    from trinoc.calib.calibrate_points import calibrate_points
    from trinoc.calib.detect.detect_pattern import detect_pattern
    from trinoc.calib.downstream import epipolar_sigma, point_covariance
    from trinoc.calib.intrinsics.calibrate_intrinsics import calibrate_intrinsics
    from trinoc.calib.joint.moved import check_rig
    from trinoc.calib.joint.refine import refine
    from trinoc.calib.pattern import Pattern
    from trinoc.calib.systematics import Systematics, with_systematics
    from trinoc.geometry.camera import Camera
    from trinoc.geometry.intrinsics import Intrinsics
    from trinoc.geometry.rig import Rig
    from trinoc.geometry.segments import Segments
    from trinoc.io.known_shape import load_shape
    from trinoc.io.matches_npz import load_matches
    from trinoc.io.pattern_json import load_pattern
    from trinoc.io.rig_json import load_rig
    from trinoc.io.save import save
    from trinoc.io.segments_npz import load_segments
    from trinoc.match.find_segments import find_segments
    from trinoc.match.match_segments import match_segments
    from trinoc.match.matches import Matches
    from trinoc.synth.evaluation import evaluate

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
    "Matches": "trinoc.match.matches",
    "Pattern": "trinoc.calib.pattern",
    "Rig": "trinoc.geometry.rig",
    "Segments": "trinoc.geometry.segments",
    "Systematics": "trinoc.calib.systematics",
    "calibrate": "trinoc.calib.calibrate",
    "calibrate_intrinsics": "trinoc.calib.intrinsics.calibrate_intrinsics",
    "calibrate_points": "trinoc.calib.calibrate_points",
    "check_rig": "trinoc.calib.joint.moved",
    "detect_pattern": "trinoc.calib.detect.detect_pattern",
    "epipolar_sigma": "trinoc.calib.downstream",
    "evaluate": "trinoc.synth.evaluation",
    "find_segments": "trinoc.match.find_segments",
    "load_matches": "trinoc.io.matches_npz",
    "load_pattern": "trinoc.io.pattern_json",
    "load_rig": "trinoc.io.rig_json",
    "load_segments": "trinoc.io.segments_npz",
    "load_shape": "trinoc.io.known_shape",
    "match_segments": "trinoc.match.match_segments",
    "point_covariance": "trinoc.calib.downstream",
    "refine": "trinoc.calib.joint.refine",
    "save": "trinoc.io.save",
    "with_systematics": "trinoc.calib.systematics",
}


def __getattr__(name: str) -> object:
    if name == "errors":
        return importlib.import_module("trinoc.errors")
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'trinoc' has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
