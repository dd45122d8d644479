"""One case: what is before the camera, the camera, and what the calibration is told of them."""

from typing import Literal, NamedTuple

import equinox as eqx
import numpy as np

from trinoc.geometry import Camera, Intrinsics
from trinoc.synth.camera_picture.delivery import Processing
from trinoc.synth.camera_picture.optics import Optics
from trinoc.synth.camera_picture.scene import SheetScene
from trinoc.synth.camera_picture.sensor import Sensor


class SheetGrid(NamedTuple):
    """The layout of a sheet: circles, their distance and radius in mm."""

    rows: int = 8
    columns: int = 8
    pitch_mm: float = 20.0
    radius_mm: float = 6.0


class LensError(eqx.Module):
    """How the lens differs from what is said of it.

    Fields
    ------
    focal_length : share by which it is longer.
    aspect : share by which the focal length along v, in pixels, is longer than that along u.
    principal_point_px : by which the principal point is off, along u and v.
    """

    focal_length: float = 0.0
    aspect: float = 0.0
    principal_point_px: tuple[float, float] = (0.0, 0.0)

    def of(self, said: Intrinsics) -> Intrinsics:
        """The lens as it is."""
        stretch = (1 + self.focal_length) * np.array([1.0, 1 + self.aspect])
        return Intrinsics(
            focal_length_px=np.asarray(said.focal_length_px) * stretch,
            principal_point_px=np.asarray(said.principal_point_px) + self.principal_point_px,
            distortion=None if said.distortion_model == "none" else np.asarray(said.distortion),
            image_size_px=said.image_size_px,
        )


class Told(NamedTuple):
    """What the calibration is told.

    Fields
    ------
    parameters : 4 or 6.
    exact : what is taken as exact: "all" of it, the "lens" alone, or "nothing".
    print_scale : measured scales of the print.
    bayer : colours of the mosaic.
    response : of the camera.
    """

    parameters: int = 4
    exact: Literal["all", "lens", "nothing"] = "all"
    print_scale: tuple[float, float] = (1.0, 1.0)
    bayer: str | None = None
    response: Literal["linear", "srgb", "fit"] = "fit"


class Condition(eqx.Module):
    """A named case of `conditions`.

    Fields
    ------
    scene, optics, sensor, processing : the picture.
    sheet : the layout.
    distortion : Brown-Conrady coefficients that the lens has and is said to have.
    lens_error : what it has and is not said to have.
    aim_mm : point of the sheet on the optical axis.
    distance_scale : how much further away the camera is than the pose says.
    turn_deg : of the camera about its axis, on top of the pose's swing.
    told : what the calibration knows besides pattern and lens.
    """

    scene: SheetScene = SheetScene()
    optics: Optics = Optics()
    sensor: Sensor = Sensor()
    processing: Processing = Processing()
    sheet: SheetGrid = SheetGrid()
    distortion: tuple[float, ...] = ()
    lens_error: LensError = LensError()
    aim_mm: tuple[float, float] = (0.0, 0.0)
    distance_scale: float = 1.0
    turn_deg: float = 0.0
    told: Told = Told()

    def said_lens(self, ideal: Intrinsics) -> Intrinsics:
        """An ideal lens with the distortion that everybody knows of."""
        return Intrinsics(
            focal_length_px=np.asarray(ideal.focal_length_px),
            principal_point_px=np.asarray(ideal.principal_point_px),
            distortion=self.distortion or None,
            image_size_px=ideal.image_size_px,
        )

    def camera(self, ideal: Intrinsics, pose: tuple[float, float, float, float]) -> Camera:
        """The camera at (pan, tilt, swing in degrees, distance in mm), as it is."""
        pan, tilt, swing, distance = pose
        return Camera.from_degrees(
            self.lens_error.of(self.said_lens(ideal)),
            pan_deg=pan,
            tilt_deg=tilt,
            swing_deg=swing + self.turn_deg,
            distance_mm=distance * self.distance_scale,
            aim_mm=self.aim_mm,
        )
