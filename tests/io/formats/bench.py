"""A rig of the bench with distortion, and matches of a box, for readers of other tools."""

import numpy as np

from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, Matches

POSES = {
    "upper": (2.143, 53.252, -1.714, 476.369),
    "right": (23.568, 38.616, -0.994, 472.894),
    "left": (-23.241, 38.264, 0.872, 474.471),
}


def bench_rig(coefficients: int = 5, cameras: int = 3) -> Rig:
    """The published rig, each camera with a lens of its own and a covariance of all."""
    distortion = (-0.12, 0.03, 0.002, -0.001, 0.01)[:coefficients]
    members = {}
    for number, (name, (pan, tilt, swing, distance)) in enumerate(list(POSES.items())[:cameras]):
        lens = Intrinsics(
            focal_length_mm=16.0 + number,
            pixel_pitch_mm=(0.0162, 0.0134),
            image_size_px=(512, 480 + number),
            principal_point_px=(250.25 + number, 241.75),
            distortion=distortion or None,
        )
        members[name] = Camera.from_degrees(
            lens, pan_deg=pan, tilt_deg=tilt, swing_deg=swing, distance_mm=distance
        )
    names = [f"{name}.pan_deg" for name in members]
    return Rig(members, parameters=names, covariance=np.eye(len(names)) * 1e-6)


def bench_matches(tracks: int = 12) -> Matches:
    """Tracks of three views and of two, with covariances."""
    random = np.random.default_rng(7)
    index = random.integers(0, 90, (tracks, 3))
    index[1::3, 2] = -1
    fragments = random.uniform(0, 500, (tracks, 3, 2, 2))
    fragments[index < 0] = np.nan
    root = random.normal(scale=0.05, size=(tracks, 6, 6))
    return Matches(
        views=tuple(POSES),
        index=index,
        fragments_px=fragments,
        lines_mm=random.uniform(-60, 60, (tracks, 2, 3)),
        covariance_mm2=root @ root.transpose(0, 2, 1),
        stage=np.where((index >= 0).all(axis=1), TRINOCULAR, BINOCULAR),
        posterior=random.uniform(0.5, 1, tracks),
        rival_posterior=random.uniform(0, 0.5, tracks),
        reasons={name: np.array(["matched"] * 90) for name in POSES},
        counts={"candidates": 12},
        misfit=np.where((index >= 0).all(axis=1), 1.5, np.nan),
    )
