"""Each value as columns of a table: what cards and frames share."""

from functools import singledispatch
from typing import Any

import numpy as np

from trinoc.calib.bundle.result import RefineResult
from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.targets.pattern import Pattern
from trinoc.evaluation.evaluation import Evaluation
from trinoc.geometry.rig import Rig
from trinoc.numerics.tables import Table
from trinoc.report.parameter_table import shown_parameters, shown_value

Columns = dict[str, Any]


@singledispatch
def list_columns(value: object) -> Columns:
    """Columns of a value by name, all with one length. Units are in the names."""
    raise TypeError(f"{type(value).__name__} has no table.")


@list_columns.register
def _rig(rig: Rig) -> Columns:
    rows = [(name, parameter) for name in rig for parameter in shown_parameters(rig)]
    return {
        "camera": [name for name, _ in rows],
        "parameter": [parameter for _, parameter in rows],
        "value": [shown_value(rig, *row)[0] for row in rows],
        "sigma": [shown_value(rig, *row)[1] for row in rows],
    }


@list_columns.register
def _calibration(result: CalibrationResult) -> Columns:
    columns = _rig(result.rig)
    return {**columns, "status": [result.status[name].name for name in columns["camera"]]}


@list_columns.register
def _refinement(result: RefineResult) -> Columns:
    sigmas = np.sqrt(np.maximum(np.diagonal(result.covariance), 0.0))
    return {
        "parameter": list(result.parameters),
        "value": np.asarray(result.values),
        "sigma": sigmas,
    }


@list_columns.register
def _pattern(pattern: Pattern) -> Columns:
    return {
        "x_mm": np.asarray(pattern.centres_mm)[:, 0],
        "y_mm": np.asarray(pattern.centres_mm)[:, 1],
        "radius_mm": np.asarray(pattern.radius_mm),
        "inner_radius_mm": np.asarray(pattern.inner_radius_mm),
    }


@list_columns.register
def _table(table: Table) -> Columns:
    return table.named_columns()


@list_columns.register
def _evaluation(evaluation: Evaluation) -> Columns:
    return {name: [value] for name, value in evaluation.record().items()}
