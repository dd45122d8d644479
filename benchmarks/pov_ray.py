"""Scenes and cameras as POV-Ray text, and their rendering by POV-Ray (Debian package povray).

POV-Ray's image plane is spanned by vectors, so that the camera of a trinoc rig is given to it
without any angle: rays of pixel (u, v) of a W x H picture run along
direction + ((u + 1/2) / W - 1/2) right + (1/2 - (v + 1/2) / H) up.
"""

import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from simulation.scenes import Scene
from simulation.solids import Cylinder
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.camera import Camera


class Light(NamedTuple):
    """Light of a block scene: one soft lamp, two lamps without shadow, and light from all over.

    Each strength is the grey level, of 1, of a white face that looks straight at the lamp.
    Without `shadows` the soft lamp throws none either.
    """

    key_from_mm: tuple[float, float, float]
    key: float
    key_side_mm: float
    fill_from_mm: tuple[float, float, float]
    fill: float
    second_fill_from_mm: tuple[float, float, float]
    second_fill: float
    ambient: float
    shadows: bool = True


def render(
    body: str, camera: Camera, *, fold: int, threads: int = 2, colour: bool = False
) -> np.ndarray:
    """The picture before blur and noise, (h fold, w fold), in grey levels from 0 to 255.

    Each of its pixels, of which a camera's pixel holds fold x fold, is the mean over its
    square as far as POV-Ray's antialiasing makes it so. In `colour`, (h fold, w fold, 3): red,
    green and blue.
    """
    width, height = (side * fold for side in camera.image_size_px)
    with tempfile.TemporaryDirectory() as folder:
        scene, picture = Path(folder, "scene.pov"), Path(folder, "picture.png")
        scene.write_text(_HEADER + _camera(camera) + body)
        command = [
            "povray", f"+I{scene}", f"+O{picture}", f"+W{width}", f"+H{height}", f"+WT{threads}",
            "+FN16", f"Grayscale_Output={'off' if colour else 'on'}", "File_Gamma=1.0",
            "-D", "-J", "+A0.02", "+AM1", "+R3",
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise RuntimeError(f"POV-Ray failed:\n{done.stderr[-3000:]}")
        levels = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)
    if levels is None or levels.dtype != np.uint16:
        raise RuntimeError("POV-Ray wrote no 16-bit picture.")
    if colour:
        levels = levels[..., ::-1]
    elif levels.ndim == 3:
        levels = levels[..., 0]
    return levels * (255.0 / 65535.0)


def blocks_text(scene: Scene, face_greys: list[np.ndarray], table_grey: float, light: Light) -> str:
    """A table at Z = 0 with the scene's solids.

    Each face has one reflectance, 0 to 1, or three: of red, green and blue.
    """
    parts = [_lights(light), f"plane {{ z, 0 {_matt(table_grey, light.ambient)} }}\n"]
    for solid, greys in zip(scene.solids, face_greys, strict=True):
        if isinstance(solid, Cylinder):
            top = solid.base_centre_mm + np.array([0.0, 0.0, solid.height_mm])
            ends = f"{_vector(solid.base_centre_mm)}, {_vector(top)}, {solid.radius_mm:.9f}"
            parts.append(f"cylinder {{ {ends} {_matt(greys[0], light.ambient)} }}\n")
            continue
        for triangles, grey in zip(solid.face_triangles_mm, greys, strict=True):
            corners = " ".join(
                f"triangle {{ {', '.join(_vector(corner) for corner in triangle)} }}"
                for triangle in triangles
            )
            parts.append(f"mesh {{ {corners} {_matt(grey, light.ambient)} }}\n")
    return "".join(parts)


def sheet_text(
    pattern: Pattern, *, size_mm: tuple[float, float], paper: float, ink: float, table: float
) -> str:
    """The printed sheet on a table, in a lamp's light that falls off across it.

    The layers of ink lie a millionth of a millimetre over each other: enough for the order. At a
    ten-thousandth their parallax moved the aim of the demo's rig by half a sigma.
    """
    lamp = (-350.0, -500.0, 900.0)
    parts = [
        f"light_source {{ {_vector(lamp)} color rgb 1.03 shadowless "
        "fade_distance 1100 fade_power 2 }\n",
        f"plane {{ z, -0.1 {_matt(table, 0.0)} }}\n",
        _polygon(-size_mm[0] / 2, size_mm[0] / 2, -size_mm[1] / 2, size_mm[1] / 2, 0.0, paper),
    ]
    half, (reach_x, reach_y) = pattern.line_width_mm / 2, pattern.line_half_length_mm
    parts.append(_polygon(-reach_x, reach_x, -half, half, 1e-6, ink))
    parts.append(_polygon(-half, half, -reach_y, reach_y, 2e-6, ink))
    for centre, radius, inner in zip(
        pattern.centres_mm, pattern.radius_mm, pattern.inner_radius_mm, strict=True
    ):
        centre_text = _vector((*centre, 1e-6))
        parts.append(f"disc {{ {centre_text}, z, {radius:.9f}, {inner:.9f} {_matt(ink, 0.0)} }}\n")
    return "".join(parts)


_HEADER = """#version 3.7;
global_settings { assumed_gamma 1.0 }
background { color rgb 0 }
"""


def _camera(camera: Camera) -> str:
    """The pinhole camera of a picture whose principal point is its centre."""
    intrinsics = camera.intrinsics
    width, height = camera.image_size_px
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    if intrinsics.distortion_model != "none" or np.any(intrinsics.principal_point_px != centre):
        raise ValueError("POV-Ray renders a lens without distortion, centred on the picture.")
    right, down, forward = np.asarray(camera.pose.rotation)
    across = width / float(intrinsics.focal_length_px[0])
    upward = height / float(intrinsics.focal_length_px[1])
    return (
        f"camera {{ perspective location {_vector(camera.centre_world_mm)} "
        f"direction {_vector(forward)} right {_vector(across * right)} "
        f"up {_vector(-upward * down)} }}\n"
    )


def _lights(light: Light) -> str:
    key, side = np.array(light.key_from_mm), light.key_side_mm
    across = np.cross(key, (0.0, 0.0, 1.0))
    across = across / np.linalg.norm(across)
    upward = np.cross(across, key) / np.linalg.norm(key)
    area = (
        f"area_light {_vector(side * across)}, {_vector(side * upward)}, 9, 9 adaptive 0"
        if side > 0
        else ""
    )
    return (
        f"light_source {{ {_vector(key)} color rgb {light.key:.6f} "
        f"{area if light.shadows else 'shadowless'} }}\n"
        f"light_source {{ {_vector(light.fill_from_mm)} color rgb {light.fill:.6f} shadowless }}\n"
        f"light_source {{ {_vector(light.second_fill_from_mm)} "
        f"color rgb {light.second_fill:.6f} shadowless }}\n"
    )


def _polygon(x0: float, x1: float, y0: float, y1: float, z: float, grey: float) -> str:
    corners = [(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z), (x0, y0, z)]
    points = ", ".join(_vector(corner) for corner in corners)
    return f"polygon {{ 5, {points} {_matt(grey, 0.0)} }}\n"


def _matt(reflectance: float | np.ndarray, ambient: float) -> str:
    red, green, blue = np.broadcast_to(reflectance, 3)
    return (
        f"pigment {{ color rgb <{red:.6f}, {green:.6f}, {blue:.6f}> }} "
        f"finish {{ ambient 0 diffuse 1 emission {ambient:.6f} }}"
    )


def _vector(values) -> str:
    return "<" + ", ".join(f"{float(value):.12g}" for value in values) + ">"
