"""Time and memory of one refinement, beside scipy and Ceres on the same unknowns and residuals.

    python benchmarks/refine_times.py [--scipy-seconds N] [--ceres]

Six free numbers per camera, four per line, no sheet, from the same start. scipy.optimize's
least_squares gets the sparsity of its Jacobian and is stopped after --scipy-seconds. pyceres has
no residual of a line, so that its cost function is written in Python (Jacobians by finite
differences, lines eliminated by its Schur complement): what is timed is Python as much as Ceres.
"""

import argparse
import resource
import signal
import time
from collections.abc import Callable

import numpy as np
from refine import made_lines, projected, started_from
from refine_rigs import ANGLE, TRUTH, rig_at
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix
from scipy.spatial.transform import Rotation

from trinoc.calib.bundle.refinement import refine
from trinoc.geometry import LineObservations
from trinoc.geometry.rig import Rig


class Stopped(Exception):
    """A solver took longer than it was given."""


def times(scipy_seconds: int, with_ceres: bool) -> None:
    """Warm time and memory beside scipy with the same problem's sparsity."""
    print("\nTime of one refinement (six free numbers per camera, no sheet), and peak memory")
    for tracks in (100, 1000, 10_000):
        random = np.random.default_rng(tracks)
        lines, _, _ = made_lines(random, tracks, 0.3, 0.0)
        values = TRUTH + np.where(ANGLE, 0.05, 0.2) * random.standard_normal(12)
        start = rig_at(values)
        lines = started_from(start, lines)
        laps = [seconds(lambda: refine(start, lines, pose_model="rigid")) for _ in range(4)]  # noqa: B023
        ours = float(np.median(laps[1:]))
        row = f"  {tracks:6d} tracks: first {laps[0]:6.2f} s, warm {1e3 * ours:8.1f} ms"
        print(f"{row}, peak so far {peak_mib():5.0f} MiB", flush=True)
        problem = Residuals(start, lines)
        others = {"scipy": problem.scipy}
        if with_ceres and tracks <= 1000:
            others["pyceres, cost in Python"] = problem.ceres
        for label, solve in others.items():
            signal.alarm(scipy_seconds)
            try:
                theirs = seconds(solve)
                signal.alarm(0)
                text = f"{theirs:7.2f} s ({theirs / ours:6.1f} x)"
            except Stopped:
                text = f"not done in {scipy_seconds} s"
            print(f"         {label} {text}, peak so far {peak_mib():5.0f} MiB", flush=True)


def seconds(call: Callable[[], object]) -> float:
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


class Residuals:
    """The same unknowns and residuals in NumPy: distances of ends across lines, in sigmas."""

    def __init__(self, rig: Rig, lines: LineObservations) -> None:
        self.lines = lines
        self.calibration = np.stack([np.asarray(c.intrinsics.matrix) for c in rig.cameras])
        self.rotation = np.stack([np.asarray(c.pose.rotation) for c in rig.cameras])
        self.centre = np.stack([c.centre_world_mm for c in rig.cameras])
        axis = np.diff(lines.lines_mm, axis=1)[:, 0]
        first = np.cross(axis, np.eye(3)[np.abs(axis).argmin(axis=1)])
        self.first = first / np.linalg.norm(first, axis=1, keepdims=True)
        self.second = np.cross(axis, self.first) / np.linalg.norm(axis, axis=1, keepdims=True)
        way = np.diff(lines.fragments_px, axis=2)[:, :, 0]
        normal = np.stack([-way[..., 1], way[..., 0]], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        covariance = lines.covariance_px2[..., :2, :2]
        self.sigma = np.sqrt(np.einsum("tvi,tvij,tvj->tv", normal, covariance, normal))

    def matrices(self, step: np.ndarray) -> np.ndarray:
        """(v, 3, 4) of the cameras after steps (v, 6)."""
        turned = Rotation.from_rotvec(step[:, :3]).as_matrix() @ self.rotation
        moved = -np.einsum("vij,vj->vi", turned, self.centre + 470 * step[:, 3:])
        return self.calibration @ np.concatenate([turned, moved[..., None]], axis=2)

    def ends(self, offset: np.ndarray) -> np.ndarray:
        """(t, 2, 3) anchors after offsets (t, 2, 2)."""
        moved = offset[..., :1] * self.first[:, None] + offset[..., 1:] * self.second[:, None]
        return self.lines.lines_mm + moved

    def all(self, x: np.ndarray) -> np.ndarray:
        """Every residual, for scipy."""
        tracks, views = self.lines.seen.shape
        step, offset = x[: 6 * views].reshape(views, 6), x[6 * views :].reshape(tracks, 2, 2)
        image = projected(self.matrices(step), self.ends(offset))
        distance = across(image, self.lines.fragments_px) / self.sigma[..., None]
        return np.where(self.lines.seen[..., None], distance, 0.0).reshape(-1)

    def scipy(self) -> None:
        """least_squares with the sparsity of the Jacobian, and soft_l1."""
        tracks, views = self.lines.seen.shape
        pattern = lil_matrix((tracks * views * 2, 6 * views + 4 * tracks), dtype=np.int8)
        for track in range(tracks):
            for view in range(views):
                row = slice(2 * (track * views + view), 2 * (track * views + view) + 2)
                pattern[row, 6 * view : 6 * view + 6] = 1
                pattern[row, 6 * views + 4 * track : 6 * views + 4 * track + 4] = 1
        start = np.zeros(pattern.shape[1])
        found = least_squares(self.all, start, jac_sparsity=pattern, x_scale="jac", loss="soft_l1")
        print(f"         ({found.nfev} evaluations, final cost {found.cost:.6g}: {found.message})")

    def ceres(self) -> None:
        """Ceres with one cost function in Python for each fragment, and Schur elimination."""
        import pyceres

        residuals = self

        class Fragment(pyceres.CostFunction):
            def __init__(self, track: int, view: int) -> None:
                super().__init__()
                self.track, self.view = track, view
                self.set_num_residuals(2)
                self.set_parameter_block_sizes([6, 4])

            def Evaluate(self, parameters, values, jacobians):
                at = np.concatenate(parameters)
                points = np.vstack([at, at + STEP * np.eye(10)]) if jacobians else at.reshape(1, -1)
                found = residuals.one(self.track, self.view, points)
                values[:] = found[0]
                if jacobians:
                    slopes = ((found[1:] - found[0]) / STEP).T
                    for block, columns in ((0, slice(0, 6)), (1, slice(6, 10))):
                        if jacobians[block] is not None:
                            jacobians[block][:] = slopes[:, columns].reshape(-1)
                return True

        tracks, views = self.lines.seen.shape
        cameras, offsets = np.zeros((views, 6)), np.zeros((tracks, 4))
        problem, loss = pyceres.Problem(), pyceres.SoftLOneLoss(1.0)
        kept = []
        for track, view in np.argwhere(self.lines.seen).tolist():
            kept.append(Fragment(track, view))
            problem.add_residual_block(kept[-1], loss, [cameras[view], offsets[track]])
        options = pyceres.SolverOptions()
        options.linear_solver_type = pyceres.LinearSolverType.DENSE_SCHUR
        options.max_num_iterations = 100
        options.num_threads = 1
        summary = pyceres.SolverSummary()
        pyceres.solve(options, problem, summary)
        print(f"         ({summary.BriefReport()})")

    def one(self, track: int, view: int, points: np.ndarray) -> np.ndarray:
        """(n, 2) residuals of one fragment for n steps of its camera and line."""
        turned = Rotation.from_rotvec(points[:, :3]).as_matrix() @ self.rotation[view]
        shifted = self.centre[view] + 470 * points[:, 3:6]
        offset = points[:, 6:].reshape(-1, 2, 2)
        moved = offset[..., :1] * self.first[track] + offset[..., 1:] * self.second[track]
        rays = self.lines.lines_mm[track] + moved - shifted[:, None]
        image = np.einsum("ij,njk,nek->nei", self.calibration[view], turned, rays)
        image = image[..., :2] / image[..., 2:]
        return across(image, self.lines.fragments_px[track, view]) / self.sigma[track, view]


# Of the finite differences: steps are radians, shares of 470 mm, and mm.
STEP = 1e-7


def across(image: np.ndarray, fragments: np.ndarray) -> np.ndarray:
    """(..., 2) distances of fragments' ends from the lines through image points (..., 2, 2)."""
    along = image[..., 1, :] - image[..., 0, :]
    normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return ((fragments - image[..., :1, :]) * normal[..., None, :]).sum(axis=-1)


def stop(_signal: int, _frame: object) -> None:
    raise Stopped


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scipy-seconds", type=int, default=480)
    parser.add_argument("--ceres", action="store_true", help="needs the package pyceres")
    given = parser.parse_args()
    signal.signal(signal.SIGALRM, stop)
    times(given.scipy_seconds, given.ceres)


if __name__ == "__main__":
    main()
