"""Time and memory of one refinement, beside scipy on the same unknowns and residuals.

Six free numbers per camera, four per line, no sheet, from the same start. scipy.optimize's
least_squares gets the sparsity of its Jacobian and is stopped after a time.
"""

import resource
import signal
import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix
from scipy.spatial.transform import Rotation

from refine_parts.made import made_lines, projected, started_from
from refine_parts.rigs import ANGLE, TRUTH, rig_at
from trinoc.calib.bundle.refinement import refine
from trinoc.geometry import LineObservations
from trinoc.geometry.rig import Rig


class Stopped(Exception):
    """A solver took longer than its time limit."""


def times(scipy_seconds: int) -> None:
    """Print warm time and memory, against scipy with the same problem's sparsity."""
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
        signal.alarm(scipy_seconds)
        try:
            theirs = seconds(problem.scipy)
            signal.alarm(0)
            text = f"{theirs:7.2f} s ({theirs / ours:6.1f} x)"
        except Stopped:
            text = f"not done in {scipy_seconds} s"
        print(f"         scipy {text}, peak so far {peak_mib():5.0f} MiB", flush=True)


def seconds(call: Callable[[], object]) -> float:
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


class Residuals:
    """Unknowns and residuals of `refine` in NumPy: distances of ends across lines, in sigmas."""

    def __init__(self, rig: Rig, lines: LineObservations) -> None:
        self.lines = lines
        self.calibration = np.stack([np.asarray(c.intrinsics.matrix) for c in rig.cameras])
        self.rotation = np.stack([np.asarray(c.pose.rotation) for c in rig.cameras])
        self.centre = np.stack([c.centre_world_mm for c in rig.cameras])
        axis = np.diff(lines.lines_mm, axis=1)[:, 0]
        first = np.cross(axis, np.eye(3)[np.abs(axis).argmin(axis=1)])
        self.first = first / np.linalg.norm(first, axis=1, keepdims=True)
        self.second = np.cross(axis, self.first) / np.linalg.norm(axis, axis=1, keepdims=True)
        direction = np.diff(lines.fragments_px, axis=2)[:, :, 0]
        normal = np.stack([-direction[..., 1], direction[..., 0]], axis=-1)
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
        """All residuals, as a vector for scipy."""
        tracks, views = self.lines.seen.shape
        step, offset = x[: 6 * views].reshape(views, 6), x[6 * views :].reshape(tracks, 2, 2)
        image = projected(self.matrices(step), self.ends(offset))
        distance = across(image, self.lines.fragments_px) / self.sigma[..., None]
        return np.where(self.lines.seen[..., None], distance, 0.0).reshape(-1)

    def scipy(self) -> None:
        """Solve by least_squares with the Jacobian's sparsity and soft_l1; print the outcome."""
        tracks, views = self.lines.seen.shape
        pattern = lil_matrix((tracks * views * 2, 6 * views + 4 * tracks), dtype=np.int8)
        for track in range(tracks):
            for view in range(views):
                row = slice(2 * (track * views + view), 2 * (track * views + view) + 2)
                pattern[row, 6 * view : 6 * view + 6] = 1
                pattern[row, 6 * views + 4 * track : 6 * views + 4 * track + 4] = 1
        start = np.zeros(pattern.shape[1])
        solution = least_squares(
            self.all, start, jac_sparsity=pattern, x_scale="jac", loss="soft_l1"
        )
        print(
            f"         ({solution.nfev} evaluations, final cost {solution.cost:.6g}: "
            f"{solution.message})"
        )


def across(image: np.ndarray, fragments: np.ndarray) -> np.ndarray:
    """(..., 2) distances of fragments' ends from the lines through image points (..., 2, 2)."""
    along = image[..., 1, :] - image[..., 0, :]
    normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return ((fragments - image[..., :1, :]) * normal[..., None, :]).sum(axis=-1)


def stop(_signal: int, _frame: object) -> None:
    raise Stopped


def run(scipy_seconds: int) -> None:
    """Print the table."""
    signal.signal(signal.SIGALRM, stop)
    times(scipy_seconds)
