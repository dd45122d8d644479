"""The paper's rig: calibrated by a sheet, knocked, and errors of its estimates."""

import numpy as np
from scipy.spatial.transform import Rotation

from trinoc.geometry import Pose
from trinoc.geometry.camera import Camera
from trinoc.geometry.rig import Rig
from trinoc.synth import table1_rig

PARAMETERS = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")
TRUE_RIG = table1_rig()
NAMES = tuple(f"{camera}.{name}" for camera in TRUE_RIG for name in PARAMETERS)
TRUTH = np.array([getattr(TRUE_RIG[camera], name) for camera in TRUE_RIG for name in PARAMETERS])
ANGLE = np.array([name.endswith("_deg") for name in NAMES])
# What a good picture of the sheet leaves, in degrees and mm.
SHEET_SIGMA = np.where(ANGLE, 0.0015, 0.0045)
# Disturbances of the angles (deg) with those of the distance or centre (mm).
SIZES = ((0.05, 0.1), (0.2, 1.0), (0.5, 2.5), (1.0, 5.0))


def rig_at(values: np.ndarray, covariance: np.ndarray | None = None) -> Rig:
    """The rig with other values of its twelve parameters."""
    rows = values.reshape(len(TRUE_RIG), 4).tolist()
    cameras = {
        name: Camera.from_degrees(camera.intrinsics, **dict(zip(PARAMETERS, row, strict=True)))
        for (name, camera), row in zip(TRUE_RIG.items(), rows, strict=True)
    }
    if covariance is None:
        return Rig(cameras)
    return Rig(cameras, parameters=NAMES, covariance=covariance)


def calibrated_rig(random: np.random.Generator) -> Rig:
    """Rig as a good sheet calibrates it."""
    values = TRUTH + SHEET_SIGMA * random.standard_normal(len(TRUTH))
    return rig_at(values, np.diag(SHEET_SIGMA**2))


def knocked(rig: Rig, names: tuple[str, ...], size: tuple[float, float], random) -> Rig:
    """The rig with some cameras turned and shifted by (deg, mm), in random directions."""
    cameras = {}
    for name, camera in rig.items():
        if name in names:
            turn, shift = (v / np.linalg.norm(v) for v in random.standard_normal((2, 3)))
            turned = Rotation.from_rotvec(np.radians(size[0]) * turn).as_matrix()
            turned = turned @ np.asarray(camera.pose.rotation)
            centre = np.asarray(camera.centre_world_mm) + size[1] * shift
            pose = Pose(np.column_stack([turned, -turned @ centre]))
            camera = Camera(camera.intrinsics, pose)
        cameras[name] = camera
    return Rig(cameras)


def relative_error(rig: Rig, truth: Rig) -> tuple[float, float]:
    """Rms errors of orientation (deg) and centre (mm) after the best similarity of both rigs.

    What no segment tells is taken out: position, orientation and scale of the whole rig.
    """
    turns = [
        np.asarray(a.pose.rotation).T @ np.asarray(b.pose.rotation)
        for a, b in zip(rig.cameras, truth.cameras, strict=True)
    ]
    common = Rotation.from_matrix(turns).mean()
    angles = (common.inv() * Rotation.from_matrix(turns)).magnitude()
    ours, theirs = (np.stack([c.centre_world_mm for c in r.cameras]) for r in (rig, truth))
    ours, theirs = ours - ours.mean(axis=0), theirs - theirs.mean(axis=0)
    turned = common.inv().apply(ours)
    turned *= (turned * theirs).sum() / (turned * turned).sum()
    return (
        float(np.degrees(np.sqrt(np.mean(angles**2)))),
        float(np.sqrt(((turned - theirs) ** 2).sum(axis=1).mean())),
    )


def camera_error(rig: Rig, truth: Rig, name: str) -> tuple[float, float]:
    """Errors of orientation (deg) and centre (mm) of one camera in the common world."""
    a, b = rig[name], truth[name]
    turn = np.asarray(a.pose.rotation) @ np.asarray(b.pose.rotation).T
    return (
        float(np.degrees(Rotation.from_matrix(turn).magnitude())),
        float(np.linalg.norm(np.asarray(a.centre_world_mm) - np.asarray(b.centre_world_mm))),
    )
