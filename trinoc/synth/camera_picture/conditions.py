"""The table of named conditions: pictures that cameras deliver, and what can be wrong with them.

The reference is an industrial camera over a flat sheet: paper at 230 and ink at 24 grey levels
of 8 bits, linear, blur 0.7 px, noise 2 grey levels. Every other row changes what its name says.
"""

from typing import Any

from trinoc.synth.camera_picture.condition import Condition, LensError, SheetGrid, Told
from trinoc.synth.camera_picture.cover import Card, Finger
from trinoc.synth.camera_picture.delivery import Processing, Sharpening
from trinoc.synth.camera_picture.denoise import Bilateral, Median, NonLocalMeans
from trinoc.synth.camera_picture.light import Lamp, Light, Shadow
from trinoc.synth.camera_picture.optics import Optics
from trinoc.synth.camera_picture.paper import Paper
from trinoc.synth.camera_picture.response import SRGB, Gamma, SCurve
from trinoc.synth.camera_picture.scene import SheetScene
from trinoc.synth.camera_picture.sensor import Mosaic, Sensor
from trinoc.synth.camera_picture.surfaces import Cone, Cylinder, Surface, Twisted

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


def _bent(surface: Surface) -> Condition:
    return Condition(SheetScene(Paper(surface)), told=_BENCH)


def _rolled(sagitta_mm: float) -> Condition:
    """Bent along no side of the sheet, as rolled paper seldom is."""
    return _bent(Cylinder.from_sagitta(sagitta_mm, direction_deg=30.0))


def _misread(parameters: int = 4, **error: Any) -> Condition:
    """A lens that only its data sheet describes, and that is another."""
    told = _DATA_SHEET._replace(parameters=parameters)
    return Condition(lens_error=LensError(**error), told=told)


def _off(length: float) -> tuple[float, float]:
    """A displacement of this length, in no special direction."""
    return (0.6 * length, 0.8 * length)


_MACHINE_VISION: dict[str, Condition] = {
    "reference": Condition(),
    "10 bit": Condition(processing=Processing(bits=10)),
    "12 bit": Condition(processing=Processing(bits=12)),
    "16 bit": Condition(processing=Processing(bits=16)),
    "noise 10": Condition(sensor=Sensor(read_levels=10.0)),
    "shot noise": Condition(sensor=Sensor(read_levels=0.5, electrons_per_level=30.0)),
    "correlated noise": Condition(sensor=Sensor(correlation_px=0.8)),
    "underexposed": Condition(sensor=_UNDER),
    "overexposed": Condition(sensor=_OVER),
    "raw RGGB": Condition(sensor=_BAYER, processing=Processing(interpolation=None)),
    "raw RGGB, told": Condition(
        sensor=_BAYER, processing=Processing(interpolation=None), told=Told(bayer="RGGB")
    ),
    "Bayer bilinear": Condition(sensor=_BAYER),
    "Bayer edge-aware": Condition(sensor=_BAYER, processing=Processing(interpolation="edge-aware")),
}

_PROCESSED: dict[str, Condition] = {
    "sRGB": Condition(processing=_SRGB),
    "sRGB, told": Condition(processing=_SRGB, told=Told(response="srgb")),
    "sRGB, dark ink": Condition(_DARK_INK, processing=_SRGB),
    "sRGB and sharpening": Condition(
        processing=Processing(response=SRGB(), sharpening=Sharpening(1.0, 0.8))
    ),
    "gamma 1.8": Condition(processing=Processing(response=Gamma(1.8))),
    "s-curve": Condition(processing=Processing(response=SCurve())),
    "mild sharpening": Condition(processing=Processing(sharpening=Sharpening(1.0, 0.3))),
    "median filter": Condition(processing=Processing(denoiser=Median())),
    "bilateral filter": Condition(processing=Processing(denoiser=Bilateral())),
    "non-local means": Condition(processing=Processing(denoiser=NonLocalMeans())),
    "JPEG 90": Condition(processing=Processing(jpeg_quality=90)),
    "JPEG 60": Condition(processing=Processing(jpeg_quality=60)),
    "webcam": Condition(
        sensor=Sensor(read_levels=1.5, electrons_per_level=20.0, mosaic=Mosaic()),
        processing=Processing(response=SRGB(), sharpening=Sharpening(1.0, 0.4), jpeg_quality=85),
    ),
    "phone": Condition(
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

_BLURRED: dict[str, Condition] = {
    "blur 2 px": Condition(optics=Optics(blur_px=2.0)),
    "defocus 1.5 px": Condition(optics=Optics(blur_px=0.5, defocus_px=1.5)),
    "motion 3 px": Condition(optics=Optics(motion_px=3.0, motion_deg=25.0)),
}

_LIT: dict[str, Condition] = {
    "broad light": Condition(
        SheetScene(light=Light((0.2, -0.12), (-0.04, 0.03, -0.05))),
        sensor=Sensor(exposure=0.65 / 0.85),
    ),
    "small glare": Condition(SheetScene(light=Light(lamp=Lamp((25.0, 15.0), roughness=0.02)))),
    "faint glare": Condition(
        SheetScene(light=Light(lamp=Lamp((25.0, 15.0), roughness=0.03, strength=0.12))),
        sensor=Sensor(exposure=0.75 / 0.85),
    ),
    "vignette and broad glare": Condition(
        SheetScene(
            light=Light(vignetting=0.35, lamp=Lamp((40.0, 30.0), roughness=0.12, strength=0.25))
        ),
        sensor=Sensor(exposure=0.75 / 0.85),
    ),
    "shadow edge": Condition(SheetScene(light=Light(shadows=(Shadow((12.0, -7.0), 35.0),)))),
    "finger": Condition(SheetScene(covers=(Finger((38.0, -24.0), -50.0),))),
    "card": Condition(SheetScene(covers=(Card((-30.0, 22.0), turn_deg=20.0),))),
}

_SHEETS: dict[str, Condition] = {
    "small in the picture": Condition(distance_scale=1.5),
    "turned by 180": Condition(turn_deg=180.0),
    "4 x 4, 25 mm": Condition(sheet=SheetGrid(4, 4, 25.0, 7.5)),
    "10 x 14, 12 mm": Condition(sheet=SheetGrid(10, 14, 12.0, 3.6)),
    "bent .1 mm": _rolled(0.1),
    "bent .3 mm": _rolled(0.3),
    "bent 1 mm": _rolled(1.0),
    "cornet .3 mm": _bent(Cone.from_sagitta(0.3, apex_mm=250.0, direction_deg=60.0)),
    "twisted .3 mm": _bent(Twisted(Cylinder(), 0.3)),
    "ink gain .1 mm": Condition(SheetScene(Paper(ink_gain_mm=0.1))),
    "print .2 % larger": Condition(SheetScene(Paper(print_scale=(1.002, 1.002))), told=_BENCH),
    "print 1 % larger": Condition(SheetScene(Paper(print_scale=(1.01, 1.01))), told=_BENCH),
    "print 1 % larger, given": Condition(
        SheetScene(Paper(print_scale=(1.01, 1.01))), told=Told(print_scale=(1.01, 1.01))
    ),
    "print .1 % longer along X": Condition(
        SheetScene(Paper(print_scale=(1.001, 1.0))), told=_BENCH
    ),
    "print .1 % longer along X, six": Condition(
        SheetScene(Paper(print_scale=(1.001, 1.0))), told=_BENCH._replace(parameters=6)
    ),
}

_LENSES: dict[str, Condition] = {
    "lens distortion given": Condition(distortion=(-0.25, 0.12, 0.001, -0.0008)),
    "aim .02 mm off": Condition(aim_mm=_off(0.02), told=_BENCH),
    "aim .1 mm off": Condition(aim_mm=_off(0.1), told=_BENCH),
    "aim 3 mm off": Condition(aim_mm=_off(3.0), told=_BENCH),
    "aim .02 mm off, six": Condition(aim_mm=_off(0.02), told=_FREE_AIM),
    "aim .1 mm off, six": Condition(aim_mm=_off(0.1), told=_FREE_AIM),
    "principal point 1 px off": _misread(principal_point_px=_off(1.0)),
    "principal point 5 px off": _misread(principal_point_px=_off(5.0)),
    "principal point 5 px off, six": _misread(6, principal_point_px=_off(5.0)),
    "focal length .05 % off": _misread(focal_length=0.0005),
    "focal length .2 % off": _misread(focal_length=0.002),
    "focal length 1 % off": _misread(focal_length=0.01),
    "aspect .05 % off": _misread(aspect=0.0005),
    "aspect .2 % off": _misread(aspect=0.002),
}

CONDITIONS: dict[str, Condition] = {
    **_MACHINE_VISION, **_PROCESSED, **_BLURRED, **_LIT, **_SHEETS, **_LENSES
}  # fmt: skip
