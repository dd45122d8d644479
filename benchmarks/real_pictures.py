"""Calibration of pictures as cameras deliver them: errors over sigmas, statuses and warnings.

    python benchmarks/real_pictures.py [--pictures 8] [--first 0] [--conditions NAME ...]
        [--knowledge told default measured exact] [--method pixels points] [--processes 2]
        [--output FILE.json] [--against FILE.json]

The conditions are those of `benchmarks/picture_conditions.py`; --conditions takes names or
beginnings of names. Poses alternate, three near the paper's Table 1 and one further round the
sheet; pose and noise of a picture follow from its number. A calibration is told what its condition
names, or one knowledge for all: "default" of a printer and a data sheet, "measured" of bars that
were read and a lens that is taken to be exact, "exact" of everything. Per condition, knowledge and
method, over pictures and the four parameters:

z         rms of error / claimed sigma; 1 is right
worst     the largest |error| / sigma
50 95     percent of errors within the claimed regions of 50 and 95 %
err/CRB   rms of error / Cramer-Rao bound of the same sheet, pose, blur and noise on a linear
          camera without saturation in even light, from `picture_bound`
ok sus -  pictures that CONVERGED, are SUSPECT, have no answer (FAILED, or a crash)
far       pictures that CONVERGED and are off by more than four sigmas
silent    those of them without a note
s         median processor time of a calibration
notes     what was said, by how many pictures

--output stores every fit; --against prints the z and err/CRB of an earlier run beside the new.
"""

import argparse
import itertools
import json
import multiprocessing
import os
import pickle
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
from picture_bound import Scene, bound_of_image
from picture_conditions import CONDITIONS, Case, SheetGrid

import trinoc
from simulation.camera_picture.optics import irradiance
from simulation.camera_picture.render import delivered_picture
from simulation.camera_picture.scene import radiance
from trinoc.calib.uncertainty.systematics import data_sheet_covariance
from trinoc.errors import CalibrationError
from trinoc.numerics.precision import in_float64
from trinoc.synth import table1_lens
from trinoc.synth.rigs import TABLE_1

NAMES = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")
METHODS = ("pixels", "points")
KNOWLEDGE = ("told", "default", "measured", "exact")
LENS = table1_lens()
# Rounding to whole grey levels of 8 bits adds this variance to the noise.
ROUNDING = 1 / 12
SILENT_SIGMAS = 4.0
# Within so many sigmas lie half of all errors, and 95 % of them.
HALF_SIGMAS, WIDE_SIGMAS = 0.6745, 1.96
# Of bars that were read with a ruler, as a share of their length.
BARS_SIGMA = 5e-4
BOUND_SUPERSAMPLING = 4
PAPER_LEVEL = 230.0

Pose = tuple[float, float, float, float]
Record = dict[str, Any]


def pose_of(number: int) -> Pose:
    """Pan, tilt, swing in degrees and distance in mm of a picture."""
    random = np.random.default_rng([12, number])
    if number % 4 == 3:
        low, high = [-55.0, 28.0, -15.0, 520.0], [55.0, 65.0, 15.0, 600.0]
        values = random.uniform(low, high)
    else:
        table = np.array([TABLE_1[name] for name in ("upper", "right", "left")])
        values = table[number % 3] + random.uniform(-1.0, 1.0, 4) * [5.0, 5.0, 5.0, 15.0]
    pan, tilt, swing, distance = map(float, values)
    return pan, tilt, swing, distance


def pattern_of(sheet: SheetGrid) -> trinoc.Pattern:
    return trinoc.Pattern.cross_grid(
        rows=sheet.rows,
        columns=sheet.columns,
        pitch_mm=sheet.pitch_mm,
        radius_mm=sheet.radius_mm,
    )


def view_of(condition: Case) -> bytes:
    """Key of all settings besides the pose that the radiance depends on."""
    view = (
        condition.scene,
        condition.sheet,
        condition.lens_error,
        condition.aim_mm,
        condition.distance_scale,
        condition.focal_scale,
        condition.turn_deg,
        condition.distortion,
    )
    return pickle.dumps(view)


def records_of_picture(
    number: int, names: tuple[str, ...], knowledge_kinds: tuple[str, ...], methods: tuple[str, ...]
) -> list[Record]:
    """The fits of one pose under every condition and knowledge."""
    pose, bounds, records = pose_of(number), {}, []
    groups: dict[bytes, list[str]] = {}
    for name in names:
        groups.setdefault(view_of(CONDITIONS[name]), []).append(name)
    for group in groups.values():
        first = CONDITIONS[group[0]]
        pattern, camera = pattern_of(first.sheet), first.camera(LENS, pose)
        fine, lights = radiance(pattern, camera, first.scene), {}
        for name in group:
            condition = CONDITIONS[name]
            if condition.optics not in lights:
                lights[condition.optics] = irradiance(fine, condition.optics)
            picture = delivered_picture(
                lights[condition.optics], condition.sensor, condition.processing, seed=number
            )
            bound = bound_of(condition, pose, bounds)
            for knowledge, method in itertools.product(knowledge_kinds, methods):
                key = {"condition": name, "knowledge": knowledge, "method": method}
                fit = fit_of(picture, condition, pose, knowledge, method)
                records.append(key | {"picture": number, "bound": bound} | fit)
    return records


@in_float64
def bound_of(condition: Case, pose: Pose, cache: dict[tuple, np.ndarray]) -> list[float]:
    """Least standard deviations of the four parameters on a linear camera."""
    paper, sensor = condition.scene.paper, condition.sensor
    blur_px = condition.optics.rms_px
    rig = condition.distance_scale, condition.focal_scale
    key = (condition.sheet, *rig, blur_px, paper.ink / paper.paper)
    if key not in cache:
        # For noise as large as the paper's own level, whatever that is.
        values = np.array([*pose[:3], pose[3] * condition.distance_scale, 0.0, 0.0])
        ink = PAPER_LEVEL * paper.ink / paper.paper
        lens = Case(focal_scale=condition.focal_scale).said_lens(LENS)
        scene = Scene(pattern_of(condition.sheet), lens, values, blur_px, PAPER_LEVEL, ink)
        cache[key] = bound_of_image(scene, PAPER_LEVEL, 4, supersampling=BOUND_SUPERSAMPLING)
    middle = sensor.exposure * (paper.ink + paper.paper) / 2
    rounding = ROUNDING / 4 ** (condition.processing.bits - 8)
    noise = float(np.sqrt(sensor.noise_levels(middle) ** 2 + rounding))
    relative = noise / (255 * sensor.exposure * paper.paper)
    return [relative * float(value) for value in cache[key]]


def fit_of(picture: np.ndarray, condition: Case, pose: Pose, knowledge: str, method: str) -> Record:
    """One calibration: error, sigma, status and notes."""
    settings = condition.told
    lens = condition.said_lens(LENS)
    start = time.process_time()
    try:
        result = trinoc.calibrate(
            {"a": picture},
            pattern_of(condition.sheet).rescale(*settings.print_scale),
            lens,
            pose_model="aimed" if settings.parameters == 4 else "aim-free",
            method=method,  # pyright: ignore[reportArgumentType]
            systematics=systematics_of(settings.exact if knowledge == "told" else knowledge, lens),
            bayer=settings.bayer,
            response=settings.response,
        )
    except CalibrationError as error:
        return {"status": "FAILED", "notes": [str(error)]}
    except Exception as error:  # A crash is what the table is there to show.
        return {"status": "CRASHED", "notes": [f"{type(error).__name__}: {error}"]}
    seconds = time.process_time() - start
    values = dict(zip(result.parameters, result.values, strict=True))
    pan, tilt, swing, distance = pose
    truth = [pan, tilt, swing + condition.turn_deg, distance * condition.distance_scale]
    error = np.array([values[f"a.{name}"] for name in NAMES]) - truth
    error[:3] = (error[:3] + 180) % 360 - 180
    return {
        "status": result.status["a"].name,
        "notes": list(result.fits["a"].notes),
        "error": error.tolist(),
        "sigma": [result.sigma(f"a.{name}") for name in NAMES],
        "used": result.fits["a"].method,
        "reduced_chi_square": result.fits["a"].reduced_chi_square,
        "seconds": seconds,
    }


def systematics_of(exact: str, lens: trinoc.Intrinsics) -> trinoc.Systematics:
    """Systematic errors that the calibration assumes."""
    if exact in ("all", "exact"):
        return trinoc.Systematics()
    typical = trinoc.Systematics.typical({})
    if exact == "measured":
        return typical._replace(print_scale_sigma=(BARS_SIGMA, BARS_SIGMA), print_size_sigma=0.0)
    covariance = {"a": data_sheet_covariance(lens)} if exact in ("nothing", "default") else None
    return typical._replace(lens_covariance=covariance)


def summary_of(records: list[Record]) -> Record:
    """The row of one condition, knowledge and method."""
    fitted = [record for record in records if "error" in record]
    status = Counter(record["status"] for record in records)
    row = {
        "converged": status["CONVERGED"],
        "suspect": status["SUSPECT"],
        "failed": len(records) - len(fitted),
        "notes": Counter(kind_of(note) for record in records for note in record["notes"]),
    }
    if not fitted:
        unknown = dict.fromkeys(("z", "worst", "half", "wide", "by_bound", "seconds"), np.nan)
        return row | unknown | {"far": 0, "silent": 0}
    error, sigma, bound = (
        np.array([record[key] for record in fitted]) for key in ("error", "sigma", "bound")
    )
    z = np.abs(error / sigma)
    far = [
        record
        for record, scores in zip(fitted, z, strict=True)
        if record["status"] == "CONVERGED" and scores.max() > SILENT_SIGMAS
    ]
    return row | {
        "z": float(np.sqrt(np.mean(z**2))),
        "worst": float(z.max()),
        "half": 100 * float(np.mean(z < HALF_SIGMAS)),
        "wide": 100 * float(np.mean(z < WIDE_SIGMAS)),
        "by_bound": float(np.sqrt(np.mean((error / bound) ** 2))),
        "far": len(far),
        "silent": sum(not record["notes"] for record in far),
        "seconds": float(np.median([record["seconds"] for record in fitted])),
    }


def kind_of(note: str) -> str:
    """First seven words of a note, without words that contain digits."""
    words = [word for word in note.split() if not any(letter.isdigit() for letter in word)]
    return " ".join(words[:7])


def table_of(
    records: list[Record], knowledge: str, method: str, names: list[str], earlier: list[Record]
) -> None:
    print(f"\nmethod {method}, knowledge {knowledge}")
    print(
        f"{'condition':33s} {'z':>7s} {'worst':>7s}  50  95 {'err/CRB':>8s}  ok sus  - far silent"
        "     s  notes"
    )

    def row_of(records: list[Record], name: str) -> Record | None:
        wanted = (name, knowledge, method)
        keys = ("condition", "knowledge", "method")
        rows = [record for record in records if tuple(record[key] for key in keys) == wanted]
        return summary_of(rows) if rows else None

    for name in names:
        row, before = row_of(records, name), row_of(earlier, name)
        assert row is not None
        notes = "; ".join(f"{count} x {kind}" for kind, count in row["notes"].most_common(3))
        counts = f"{row['converged']:3d} {row['suspect']:3d} {row['failed']:2d} {row['far']:3d}"
        print(
            f"{errors_of_row(name, row)} {counts} {row['silent']:6d} {row['seconds']:5.2f}  {notes}"
        )
        if before is not None:
            print(errors_of_row("  before", before))


def errors_of_row(name: str, row: Record) -> str:
    return (
        f"{name:33s} {row['z']:7.2f} {row['worst']:7.1f} {row['half']:3.0f} {row['wide']:3.0f} "
        f"{row['by_bound']:8.2f}"
    )


def chosen(beginnings: list[str]) -> list[str]:
    """Conditions with one of these names; a name of no condition selects by its beginning."""
    names = []
    for beginning in beginnings:
        fit = [beginning] if beginning in CONDITIONS else []
        fit = fit or [name for name in CONDITIONS if name.startswith(beginning)]
        if not fit:
            raise SystemExit(f"No condition begins with {beginning!r}: {', '.join(CONDITIONS)}.")
        names += fit
    return list(dict.fromkeys(names))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--pictures", type=int, default=8)
    parser.add_argument("--first", type=int, default=0, metavar="NUMBER")
    parser.add_argument("--conditions", nargs="*", default=[""], metavar="NAME")
    parser.add_argument("--knowledge", nargs="*", choices=KNOWLEDGE, default=["told"])
    parser.add_argument("--method", nargs="*", choices=METHODS, default=list(METHODS))
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--against", type=Path)
    options = parser.parse_args()
    names, knowledge_kinds, methods = (
        chosen(options.conditions),
        tuple(options.knowledge),
        tuple(options.method),
    )
    earlier = json.loads(options.against.read_text("utf-8")) if options.against else []
    # One process a core: the libraries' own threads would only fight.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    records: list[Record] = []
    spawned = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.processes, mp_context=spawned) as pool:
        jobs = [
            pool.submit(records_of_picture, number, tuple(names), knowledge_kinds, methods)
            for number in range(options.first, options.first + options.pictures)
        ]
        for done, job in enumerate(as_completed(jobs), start=1):
            records += job.result()
            print(f"{done} of {len(jobs)} poses done", file=sys.stderr)
            if options.output:
                options.output.write_text(json.dumps(records, indent=1), "utf-8")
    for knowledge, method in itertools.product(knowledge_kinds, methods):
        table_of(records, knowledge, method, names, earlier)


if __name__ == "__main__":
    main()
