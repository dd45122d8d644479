"""Named conditions: pictures as cameras deliver them, and errors of the calibration's input.

The reference is an industrial camera over a flat sheet: paper at 230 and ink at 24 grey levels
of 8 bits, linear, blur 0.7 px, noise 2 grey levels. Every other row changes what its name says.
"""

from typing import Any, Literal, NamedTuple

import equinox as eqx
import numpy as np

from simulation.camera_picture.delivery import (
    SRGB,
    Bilateral,
    Gamma,
    Median,
    NonLocalMeans,
    Processing,
    SCurve,
    Sharpening,
)
from simulation.camera_picture.layers import cover_card, finger
from simulation.camera_picture.light import GlareLamp, Illumination, Shadow
from simulation.camera_picture.optics import Optics
from simulation.camera_picture.paper import Paper
from simulation.camera_picture.render import Condition
from simulation.camera_picture.scene import SheetScene
from simulation.camera_picture.sensor import Mosaic, Sensor
from simulation.camera_picture.surfaces import ConePaper, RolledPaper, Surface, TwistedPaper
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics


class SheetGrid(NamedTuple):
    """The layout of a sheet: circles, their distance and radius in mm."""

    rows: int = 8
    columns: int = 8
    pitch_mm: float = 20.0
    radius_mm: float = 6.0


class LensError(eqx.Module):
    """Difference of the true lens from the stated one.

    Fields
    ------
    focal_length : share by which it is longer.
    aspect : share by which the focal length along v, in pixels, is longer than that along u.
    principal_point_px : by which the principal point is off, along u and v.
    """

    focal_length: float = 0.0
    aspect: float = 0.0
    principal_point_px: tuple[float, float] = (0.0, 0.0)

    def of(self, stated: Intrinsics) -> Intrinsics:
        """The true lens."""
        stretch = (1 + self.focal_length) * np.array([1.0, 1 + self.aspect])
        return Intrinsics(
            focal_length_px=np.asarray(stated.focal_length_px) * stretch,
            principal_point_px=np.asarray(stated.principal_point_px) + self.principal_point_px,
            distortion=None if stated.distortion_model == "none" else np.asarray(stated.distortion),
            image_size_px=stated.image_size_px,
        )


class Told(NamedTuple):
    """Input of the calibration besides pattern and lens.

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


class Case(Condition):
    """A picture, and the input of its calibration.

    Fields
    ------
    sheet : the layout.
    distortion : Brown-Conrady coefficients that the lens has and is said to have.
    lens_error : what it has and is not said to have.
    aim_mm : point of the sheet on the optical axis.
    distance_scale : how much further away the camera is than the pose says.
    focal_scale : how much longer the lens is than the reference, as everybody knows.
    turn_deg : of the camera about its axis, on top of the pose's swing.
    told : what the calibration knows besides pattern and lens.
    """

    sheet: SheetGrid = SheetGrid()
    distortion: tuple[float, ...] = ()
    lens_error: LensError = LensError()
    aim_mm: tuple[float, float] = (0.0, 0.0)
    distance_scale: float = 1.0
    focal_scale: float = 1.0
    turn_deg: float = 0.0
    told: Told = Told()

    def said_lens(self, ideal: Intrinsics) -> Intrinsics:
        """The stated lens: an ideal one with the known focal length and distortion."""
        return Intrinsics(
            focal_length_px=self.focal_scale * np.asarray(ideal.focal_length_px),
            principal_point_px=np.asarray(ideal.principal_point_px),
            distortion=self.distortion or None,
            image_size_px=ideal.image_size_px,
        )

    def camera(self, ideal: Intrinsics, pose: tuple[float, float, float, float]) -> Camera:
        """The true camera at (pan, tilt, swing in degrees, distance in mm)."""
        pan, tilt, swing, distance = pose
        return Camera.from_degrees(
            self.lens_error.of(self.said_lens(ideal)),
            pan_deg=pan,
            tilt_deg=tilt,
            swing_deg=swing + self.turn_deg,
            distance_mm=distance * self.distance_scale,
            aim_mm=self.aim_mm,
        )


_SRGB = Processing(response=SRGB())
_BAYER = Sensor(mosaic=Mosaic())
# Paper reflects 0.85 of the light: at this exposure it would be a third beyond saturation.
_OVER = Sensor(exposure=1.3 / 0.85)
_UNDER = Sensor(exposure=0.3 / 0.85)
_DARK_INK = SheetScene(Paper(ink=0.02))
_FREE_AIM = Told(parameters=6)
# What people on a bench know, with a lens that was calibrated and with one from a data sheet.
_BENCH = Told(exact="lens")
_DATA_SHEET = Told(exact="nothing")


def _bent(surface: Surface) -> Case:
    return Case(SheetScene(Paper(surface)), told=_BENCH)


def _rolled(sagitta_mm: float) -> Case:
    """Paper rolled about an axis that is parallel to no side of the sheet."""
    return _bent(RolledPaper.from_sagitta(sagitta_mm, direction_deg=30.0))


def _misread(parameters: int = 4, **error: Any) -> Case:
    """A lens known from its data sheet only, which is wrong by `error`."""
    settings = _DATA_SHEET._replace(parameters=parameters)
    return Case(lens_error=LensError(**error), told=settings)


def _off(length: float) -> tuple[float, float]:
    """A displacement of this length, in a direction that is not special."""
    return (0.6 * length, 0.8 * length)


_MACHINE_VISION: dict[str, Case] = {
    "reference": Case(),
    "10 bit": Case(processing=Processing(bits=10)),
    "12 bit": Case(processing=Processing(bits=12)),
    "16 bit": Case(processing=Processing(bits=16)),
    "noise 10": Case(sensor=Sensor(read_levels=10.0)),
    "shot noise": Case(sensor=Sensor(read_levels=0.5, electrons_per_level=30.0)),
    "correlated noise": Case(sensor=Sensor(correlation_px=0.8)),
    "underexposed": Case(sensor=_UNDER),
    "overexposed": Case(sensor=_OVER),
    "raw RGGB": Case(sensor=_BAYER, processing=Processing(interpolation=None)),
    "raw RGGB, told": Case(
        sensor=_BAYER, processing=Processing(interpolation=None), told=Told(bayer="RGGB")
    ),
    "Bayer bilinear": Case(sensor=_BAYER),
    "Bayer edge-aware": Case(sensor=_BAYER, processing=Processing(interpolation="edge-aware")),
}

_PROCESSED: dict[str, Case] = {
    "sRGB": Case(processing=_SRGB),
    "sRGB, told": Case(processing=_SRGB, told=Told(response="srgb")),
    "sRGB, dark ink": Case(_DARK_INK, processing=_SRGB),
    "sRGB and sharpening": Case(
        processing=Processing(response=SRGB(), sharpening=Sharpening(1.0, 0.8))
    ),
    "gamma 1.8": Case(processing=Processing(response=Gamma(1.8))),
    "s-curve": Case(processing=Processing(response=SCurve())),
    "mild sharpening": Case(processing=Processing(sharpening=Sharpening(1.0, 0.3))),
    "median filter": Case(processing=Processing(denoiser=Median())),
    "bilateral filter": Case(processing=Processing(denoiser=Bilateral())),
    "non-local means": Case(processing=Processing(denoiser=NonLocalMeans())),
    "JPEG 90": Case(processing=Processing(jpeg_quality=90)),
    "JPEG 60": Case(processing=Processing(jpeg_quality=60)),
    "webcam": Case(
        sensor=Sensor(read_levels=1.5, electrons_per_level=20.0, mosaic=Mosaic()),
        processing=Processing(response=SRGB(), sharpening=Sharpening(1.0, 0.4), jpeg_quality=85),
    ),
    "phone": Case(
        sensor=Sensor(read_levels=1.0, electrons_per_level=12.0, mosaic=Mosaic()),
        processing=Processing(
            interpolation="edge-aware",
            denoiser=NonLocalMeans(6.0),
            response=SCurve(contrast=0.3),
            sharpening=Sharpening(1.2, 0.9),
            jpeg_quality=85,
        ),
    ),
}

_BLURRED: dict[str, Case] = {
    "blur 2 px": Case(optics=Optics(blur_px=2.0)),
    "defocus 1.5 px": Case(optics=Optics(blur_px=0.5, defocus_px=1.5)),
    "motion 3 px": Case(optics=Optics(motion_px=3.0, motion_deg=25.0)),
}

_LIT: dict[str, Case] = {
    "broad light": Case(
        SheetScene(light=Illumination((0.2, -0.12), (-0.04, 0.03, -0.05))),
        sensor=Sensor(exposure=0.65 / 0.85),
    ),
    "small glare": Case(
        SheetScene(light=Illumination(lamp=GlareLamp((25.0, 15.0), roughness=0.02)))
    ),
    "faint glare": Case(
        SheetScene(light=Illumination(lamp=GlareLamp((25.0, 15.0), roughness=0.03, strength=0.12))),
        sensor=Sensor(exposure=0.75 / 0.85),
    ),
    "vignette and broad glare": Case(
        SheetScene(
            light=Illumination(
                vignetting=0.35, lamp=GlareLamp((40.0, 30.0), roughness=0.12, strength=0.25)
            )
        ),
        sensor=Sensor(exposure=0.75 / 0.85),
    ),
    "shadow edge": Case(SheetScene(light=Illumination(shadows=(Shadow((12.0, -7.0), 35.0),)))),
    "finger": Case(SheetScene(covers=(finger((38.0, -24.0), -50.0),))),
    "card": Case(SheetScene(covers=(cover_card((-30.0, 22.0), turn_deg=20.0),))),
}

_SHEETS: dict[str, Case] = {
    "small in the picture": Case(distance_scale=1.5),
    "half the distance": Case(sheet=SheetGrid(4, 4), distance_scale=0.5),
    "wide lens, half the distance": Case(distance_scale=0.5, focal_scale=0.5),
    "turned by 180": Case(turn_deg=180.0),
    "4 x 4, 25 mm": Case(sheet=SheetGrid(4, 4, 25.0, 7.5)),
    "10 x 14, 12 mm": Case(sheet=SheetGrid(10, 14, 12.0, 3.6)),
    "bent .1 mm": _rolled(0.1),
    "bent .3 mm": _rolled(0.3),
    "bent 1 mm": _rolled(1.0),
    "cornet .3 mm": _bent(ConePaper.from_sagitta(0.3, apex_mm=250.0, direction_deg=60.0)),
    "twisted .3 mm": _bent(TwistedPaper(RolledPaper(), 0.3)),
    "ink gain .1 mm": Case(SheetScene(Paper(ink_gain_mm=0.1))),
    "print .2 % larger": Case(SheetScene(Paper(print_scale=(1.002, 1.002))), told=_BENCH),
    "print 1 % larger": Case(SheetScene(Paper(print_scale=(1.01, 1.01))), told=_BENCH),
    "print 1 % larger, given": Case(
        SheetScene(Paper(print_scale=(1.01, 1.01))), told=Told(print_scale=(1.01, 1.01))
    ),
    "print .1 % longer along X": Case(SheetScene(Paper(print_scale=(1.001, 1.0))), told=_BENCH),
    "print .1 % longer along X, six": Case(
        SheetScene(Paper(print_scale=(1.001, 1.0))), told=_BENCH._replace(parameters=6)
    ),
}

_LENSES: dict[str, Case] = {
    "lens distortion given": Case(distortion=(-0.25, 0.12, 0.001, -0.0008)),
    "aim .02 mm off": Case(aim_mm=_off(0.02), told=_BENCH),
    "aim .1 mm off": Case(aim_mm=_off(0.1), told=_BENCH),
    "aim 3 mm off": Case(aim_mm=_off(3.0), told=_BENCH),
    "aim .02 mm off, six": Case(aim_mm=_off(0.02), told=_FREE_AIM),
    "aim .1 mm off, six": Case(aim_mm=_off(0.1), told=_FREE_AIM),
    "principal point 1 px off": _misread(principal_point_px=_off(1.0)),
    "principal point 5 px off": _misread(principal_point_px=_off(5.0)),
    "principal point 5 px off, six": _misread(6, principal_point_px=_off(5.0)),
    "focal length .05 % off": _misread(focal_length=0.0005),
    "focal length .2 % off": _misread(focal_length=0.002),
    "focal length 1 % off": _misread(focal_length=0.01),
    "aspect .05 % off": _misread(aspect=0.0005),
    "aspect .2 % off": _misread(aspect=0.002),
}

CONDITIONS: dict[str, Case] = {
    **_MACHINE_VISION, **_PROCESSED, **_BLURRED, **_LIT, **_SHEETS, **_LENSES
}  # fmt: skip
