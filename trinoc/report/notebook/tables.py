"""Each value as columns of a table: what cards and frames share."""

from functools import singledispatch
from typing import Any

import numpy as np

from trinoc.calib import CalibrationResult, Pattern, RefineResult
from trinoc.evaluation import Evaluation
from trinoc.geometry import Rig, Segments
from trinoc.match import Matches, Wireframe
from trinoc.report.parameter_table import shown_parameters
from trinoc.report.track_sigmas import track_sigmas

Columns = dict[str, Any]


@singledispatch
def columns_of(value: object) -> Columns:
    """Names and values of columns, all of one length; degrees, mm and px as the names say."""
    raise TypeError(f"{type(value).__name__} has no table.")


@columns_of.register
def _rig(rig: Rig) -> Columns:
    rows = [(name, parameter) for name in rig for parameter in shown_parameters(rig)]
    return {
        "camera": [name for name, _ in rows],
        "parameter": [parameter for _, parameter in rows],
        "value": [rig.value(f"{name}.{parameter}") for name, parameter in rows],
        "sigma": [rig.sigma(f"{name}.{parameter}") for name, parameter in rows],
    }


@columns_of.register
def _calibration(result: CalibrationResult) -> Columns:
    columns = _rig(result.rig)
    return {**columns, "status": [result.status[name].name for name in columns["camera"]]}


@columns_of.register
def _refinement(result: RefineResult) -> Columns:
    sigmas = np.sqrt(np.maximum(np.diagonal(result.covariance), 0.0))
    return {
        "parameter": list(result.parameters),
        "value": np.asarray(result.values),
        "sigma": sigmas,
    }


@columns_of.register
def _pattern(pattern: Pattern) -> Columns:
    return {
        "x_mm": np.asarray(pattern.centres_mm)[:, 0],
        "y_mm": np.asarray(pattern.centres_mm)[:, 1],
        "radius_mm": np.asarray(pattern.radius_mm),
        "inner_radius_mm": np.asarray(pattern.inner_radius_mm),
    }


@columns_of.register
def _segments(segments: Segments) -> Columns:
    ends = np.asarray(segments.endpoints_px)
    names = ("u1_px", "v1_px", "u2_px", "v2_px")
    return {
        **dict(zip(names, ends.reshape(-1, 4).T, strict=True)),
        "length_px": np.asarray(segments.length_px),
        "contrast": np.asarray(segments.contrast),
        "polarity": np.asarray(segments.polarity),
        "support": np.asarray(segments.support),
    }


@columns_of.register
def _matches(matches: Matches) -> Columns:
    sigmas, index = track_sigmas(matches), np.asarray(matches.index)
    ends = np.asarray(matches.lines_mm).reshape(-1, 6)
    names = ("x1_mm", "y1_mm", "z1_mm", "x2_mm", "y2_mm", "z2_mm")
    return {
        "stage": np.asarray(matches.stage, dtype=str),
        **{f"segment_{view}": index[:, column] for column, view in enumerate(matches.views)},
        "length_mm": sigmas.length_mm,
        "length_sigma_mm": sigmas.length_sigma_mm,
        "across_sigma_mm": sigmas.across_sigma_mm,
        "posterior": np.asarray(matches.posterior),
        "rival_posterior": np.asarray(matches.rival_posterior),
        **dict(zip(names, ends.T, strict=True)),
    }


@columns_of.register
def _wireframe(frame: Wireframe) -> Columns:
    ends, pairs = frame.lines_mm, frame.edges
    step = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(step, axis=1)
    way = np.concatenate([-step, step], axis=1) / np.maximum(length, 1e-12)[:, None]
    variance = np.einsum("ei,eij,ej->e", way, frame.covariance_mm2, way)
    names = ("x1_mm", "y1_mm", "z1_mm", "x2_mm", "y2_mm", "z2_mm")
    return {
        "vertex_1": pairs[:, 0],
        "vertex_2": pairs[:, 1],
        "length_mm": length,
        "length_sigma_mm": np.sqrt(np.maximum(variance, 0.0)),
        "posterior": frame.posterior,
        "views": frame.views,
        "viewpoint_dependent": frame.viewpoint_dependent,
        **({} if frame.shadow is None else {"shadow": frame.shadow}),
        "corner_1": frame.corner[pairs[:, 0]],
        "corner_2": frame.corner[pairs[:, 1]],
        **dict(zip(names, ends.reshape(-1, 6).T, strict=True)),
    }


@columns_of.register
def _evaluation(evaluation: Evaluation) -> Columns:
    return {name: [value] for name, value in evaluation.record().items()}
