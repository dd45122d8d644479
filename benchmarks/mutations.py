"""Covariances, priors, weights and gates broken one by one: do the nearest tests see it?

    python benchmarks/mutations.py [--only WORD]

Each place is changed in a copy of the tree, and the tests that are nearest to it run there without
those marked slow. A change that no test sees survives, and is printed at the end.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parent.parent
LIMIT_S = 300.0


class Mutation(NamedTuple):
    """What stands once in `trinoc/{file}.py`, what takes its place, and the tests to run."""

    file: str
    before: str
    after: str
    tests: str


def _of(tests: str, file: str, *changes: tuple[str, str]) -> list[Mutation]:
    return [Mutation(file, before, after, tests) for before, after in changes]


MUTATIONS: list[Mutation] = [
    *_of(
        "numerics/test_small_least_squares.py",
        "numerics/small_least_squares",
        ("diagonal += at.prior_precision", "diagonal += 2 * at.prior_precision"),
        ("gradient += at.prior_precision", "gradient -= at.prior_precision"),
        ("weight = weight * np.asarray(loss.weight(squared))", "weight = 1.0 * weight"),
        ("np.linalg.inv(np.linalg.cholesky(covariance))", "np.linalg.cholesky(covariance)"),
    ),
    *_of(
        "geometry/test_rig.py",
        "geometry/rig",
        ("float(np.sqrt(self.covariance[index, index]))", "float(self.covariance[index, index])"),
    ),
    *_of(
        "geometry/test_uncertain_lines.py",
        "geometry/uncertain_lines",
        ("by @ self.parameter_covariance @ by.T", "by @ by.T"),
        ("float(jnp.sqrt(row @ covariance @ row))", "float(row @ covariance @ row)"),
    ),
    *_of(
        "geometry/test_triangulation.py",
        "geometry/triangulation",
        ("information = weight[:, None, None] * jax.vmap", "information = jax.vmap"),
    ),
    *_of(
        "geometry/test_segments.py",
        "geometry/segments",
        ("variance_along * along + variance_across", "variance_across * along + variance_along"),
    ),
    *_of(
        "calib/uncertainty",
        "calib/uncertainty/propagation",
        ("return by @ covariance @ by.T", "return by @ by.T"),
        ("by, rig.covariance_of(names), by) / 2", "by, rig.covariance_of(names), by)"),
        ('np.sqrt(np.einsum("np,pq,nq->n", by', '(np.einsum("np,pq,nq->n", by'),
    ),
    *_of(
        "calib/uncertainty",
        "calib/uncertainty/systematics",
        ("vectors[:, kept] * np.sqrt(values[kept])", "vectors[:, kept] * values[kept]"),
    ),
    *_of(
        "calib/test_calibrate.py calib/uncertainty",
        "calib/systematic_errors",
        (
            "response[:, :shared_terms] * sheet_sigma",
            "0 * response[:, :shared_terms] * sheet_sigma",
        ),
        ("size * systematics.print_size_sigma", "0 * size * systematics.print_size_sigma"),
    ),
    *_of(
        "calib/problem calib/shots/test_laws.py",
        "calib/problem/robust_fit",
        ("<= GATE * robust_scale(whitened)", "<= 5 * GATE * robust_scale(whitened)"),
    ),
    *_of(
        "calib/problem calib/shots/test_laws.py",
        "calib/problem/outcome",
        (
            "factor * covariance - (factor - 1.0) * covariance @ prior @ covariance",
            "factor * covariance",
        ),
        ("return self.factor if self.factor >", "return 1.0 if self.factor >"),
    ),
    *_of(
        "calib/shots/test_board_shape.py",
        "calib/problem/board_shape",
        ("problem.chart, spread_mm**-2.0)", "problem.chart, spread_mm**-1.0)"),
    ),
    *_of(
        "calib/photometric/test_fit_laws.py calib/photometric/test_image_precision.py",
        "calib/photometric/covariance",
        ("_sandwich(inverse, middle) * chi_square", "_sandwich(inverse, middle)"),
        ("matrix[:size, :size] - matrix[:size] @ follow", "matrix[:size, :size]"),
    ),
    *_of(
        "calib/photometric/test_photometry.py calib/photometric/test_fit_laws.py",
        "calib/photometric/noise",
        ("return level < top - _CLEAR_SIGMAS * sigma", "return level < top"),
        ("math.where(sure, level, top - sigma * gap)", "math.where(sure, level, level)"),
    ),
    *_of(
        "calib/photometric/test_fit_laws.py calib/photometric/test_clean_image.py",
        "calib/photometric/gate",
        ("kept & (total**2 <= _LARGEST_COMMON * np.maximum(count, 1))", "kept"),
        ("kept & (off <= _LARGEST_SHARE * seen)", "kept"),
    ),
    *_of(
        "calib/photometric/test_fit_laws.py",
        "calib/photometric/equations",
        ("products[:size, size] + weight * offset", "products[:size, size] - weight * offset"),
        ("+ jnp.diag(LOCAL_WIDTH**-2)[None]", "+ 0 * jnp.diag(LOCAL_WIDTH**-2)[None]"),
    ),
    *_of(
        "calib/bundle/test_covariance.py calib/bundle/test_refine.py",
        "calib/bundle/estimate",
        ("+ sheet**-2 * fit.sheet_information", "+ fit.sheet_information"),
        ("own = factor**2 * fit.own_covariance_mm2", "own = fit.own_covariance_mm2"),
        ("fit.by_step @ determined.covariance @ fit.by_step.T", "determined.covariance"),
    ),
    *_of(
        "calib/adjustment",
        "calib/adjustment/each_camera",
        ("factor**2 * seen.covariance", "seen.covariance"),
    ),
    *_of(
        "segments",
        "segments/nevatia_babu/line_fit",
        ("weight = root / np.square(1 +", "weight = root / np.square(1 + 0 *"),
        ("points.information / np.square(variance)", "points.information"),
    ),
    *_of(
        "segments",
        "segments/nevatia_babu/runs",
        ("information = strength**2 * (", "information = 2 * strength**2 * ("),
    ),
    *_of(
        "segments",
        "segments/nevatia_babu/endpoints",
        ("np.clip(tuning.sigma_free_px * faint,", "np.clip(0 * tuning.sigma_free_px * faint,"),
    ),
    *_of(
        "match/evidence match/test_covariance.py",
        "match/evidence/mixture",
        ("outside = 0.5 * np.clip(", "outside = np.clip("),
        ("weights + tuning.prior_observations * prior", "weights + 1e-9 * prior"),
    ),
    *_of(
        "match/evidence match/candidates",
        "match/evidence/triple_position",
        (
            "cut.possible & (_misfit(sight, planes, cut.along)[0] < tuning.gate)",
            "cut.possible",
        ),
    ),
    *_of(
        "match/tracks match/test_covariance.py",
        "match/tracks/line_fit",
        ("np.stack([1 - interval.T, interval.T])", "np.stack([interval.T, 1 - interval.T])"),
        ("np.where(ends_here[:, e], 0.0, push)", "np.where(ends_here[:, e], push, 0.0)"),
        (
            "chi_square_limit(chi_square_tail(gate, 2)",
            "9 * chi_square_limit(chi_square_tail(gate, 2)",
        ),
    ),
    *_of(
        "match/line_map",
        "match/line_map/line_fit",
        ("blocks = equations.covariance()", "blocks = 2 * equations.covariance()"),
        ("2 * len(shown.ends_px) - 4", "2 * len(shown.ends_px) - 2"),
    ),
    *_of(
        "match/line_map",
        "match/line_map/corners",
        ("log_passing = -0.5 * (", "log_passing = 0.5 * ("),
    ),
    *_of(
        "match/line_map",
        "match/line_map/collinearity",
        ("2, tuning) + 0.5 * np.linalg.slogdet", "2, tuning) - 0.5 * np.linalg.slogdet"),
    ),
    *_of(
        "match/line_map",
        "match/line_map/line_posterior",
        ("right * shares + (1 - right) * widest", "right * widest + (1 - right) * shares"),
    ),
    *_of(
        "match/selection",
        "match/selection/marginals",
        ("scale = np.sqrt(typical / (2 * np.log(2)))", "scale = np.sqrt(typical)"),
    ),
    *_of(
        "match/selection",
        "match/selection/junction_support",
        ("near = square <= 1", "near = square <= 9"),
    ),
    *_of(
        "match/candidates match/two_view",
        "match/candidates/search",
        ("(v11 * r0 * r0 - 2 * v01", "(v11 * r0 * r0 + 2 * v01"),
    ),
    *_of(
        "match/two_view match/evidence",
        "match/two_view/planes",
        ("covariance / (px_per_mm[:, e] * px_per_mm[:, f])", "covariance / px_per_mm[:, e]"),
    ),
    *_of(
        "match/wire_frame",
        "match/wire_frame/adjustment",
        ("np.sqrt(variance + stops**2)", "np.sqrt(variance)"),
    ),
    *_of(
        "match/wire_frame",
        "match/wire_frame/faces",
        ("square < chi_square_limit(", "square < 1e3 * chi_square_limit("),
    ),
    *_of(
        "match/cylinders",
        "match/bodies/cylinder_search",
        ("square = 0.5 * np.einsum(", "square = 100 * np.einsum("),
        ("stops = (free_end_px * mm_per_px)", "stops = (0 * mm_per_px)"),
        ("jacobian @ fits.covariance @ jacobian.mT", "jacobian @ jacobian.mT"),
    ),
    *_of(
        "match/rims",
        "match/bodies/rim_answer",
        ("slope @ rim.covariance @ slope.mT", "slope @ slope.mT"),
        ("slope @ rim.covariance @ slope.T", "slope @ slope.T"),
    ),
    *_of(
        "match/rims",
        "match/bodies/circles",
        ("factor * equations.covariance()[0]", "equations.covariance()[0]"),
    ),
    *_of(
        "match/shadows",
        "match/bodies/lamp",
        ("np.log1p(self.prior * gain)", "np.log1p(gain)"),
    ),
    *_of(
        "match/observations",
        "match/observations/clutter",
        ("density.append(np.log(here / np.pi))", "density.append(np.log(here))"),
    ),
    *_of(
        "match/observations match/evidence",
        "match/observations/side_intensity",
        ("(1 - any_level) * both / (both.sum()", "both / (both.sum()"),
    ),
    *_of(
        "match/pixels",
        "match/pixels/measure",
        ("spread * variance_factor(misfit, freedom, tail)[:, None, None]", "spread"),
    ),
    *_of(
        "match/pixels",
        "match/pixels/evidence",
        ("_USUAL / 2 / np.maximum(number, 1)", "_USUAL / 2"),
    ),
    *_of(
        "image",
        "image/noise",
        ("float(MAD_TO_SIGMA * _median(", "float(_median("),
    ),
    *_of(
        "image",
        "image/step_edge",
        ("return rise / bend, 1 / bend", "return rise / bend, bend"),
    ),
    *_of(
        "evaluation",
        "evaluation/normalised_errors",
        ("np.median(chi_square) / _MEDIAN", "np.median(chi_square)"),
        ("offsets.own_mm2 + by @ parameter_covariance @ by.mT", "offsets.own_mm2"),
    ),
    *_of(
        "evaluation",
        "evaluation/distances",
        ("np.clip(offset / squared, 0.0, 1.0)", "offset / squared"),
    ),
    *_of(
        "capture",
        "capture/measures",
        ("np.maximum(coarse[ridge], 1e-9)) ** 2", "np.maximum(coarse[ridge], 1e-9)) ** 1"),
    ),
    *_of(
        "report/test_verdict.py report/test_shots.py",
        "report/verdict",
        ("if value >= self.good if self.at_least else value <= self.good", "if value <= self.good"),
        ("return self.beyond if value <= self.bad", "return self.beyond if value <= 2 * self.bad"),
    ),
    *_of(
        "report/test_verdict.py report/test_shots.py",
        "report/coverage",
        ("/ max(2 * (count[said] - 1).sum(), 1)", "/ max((count[said] - 1).sum(), 1)"),
    ),
]


def source(mutation: Mutation) -> Path:
    """The file, below the root of a tree."""
    return Path("trinoc") / f"{mutation.file}.py"


def survives(mutation: Mutation, tree: Path) -> bool:
    """Whether the nearest tests pass on a copy of the tree in which one place is changed."""
    place = tree / source(mutation)
    text = place.read_text(encoding="utf-8")
    place.write_text(text.replace(mutation.before, mutation.after), encoding="utf-8")
    tests = [f"tests/{name}" for name in mutation.tests.split()]
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n0", "-m", "not slow", *tests]
    try:
        done = subprocess.run(
            command,
            cwd=tree,
            env={**os.environ, "PYTHONPATH": "."},
            capture_output=True,
            timeout=LIMIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False
    finally:
        place.write_text(text, encoding="utf-8")
    return done.returncode == 0


def main() -> int:
    """Print what became of each, and the survivors; 1 where there are any."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", default="", help="places whose file has this word")
    only = parser.parse_args().only
    chosen = [each for each in MUTATIONS if only in each.file]
    survivors = []
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".git", ".*_cache"))
        for each in chosen:
            began = time.monotonic()
            left = survives(each, tree)
            survivors += [each] * left
            word = "SURVIVES" if left else "seen"
            print(
                f"{word:8s} {time.monotonic() - began:4.0f} s  {each.file}: {each.after}",
                flush=True,
            )
    print(f"{len(chosen)} places, {len(survivors)} survive")
    return int(bool(survivors))


if __name__ == "__main__":
    sys.exit(main())
