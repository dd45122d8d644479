from .condition import (
    Condition as Condition,
    LensError as LensError,
    SheetGrid as SheetGrid,
    Told as Told,
)
from .conditions import CONDITIONS as CONDITIONS
from .delivery import Processing as Processing, Sharpening as Sharpening
from .light import Lamp as Lamp, Light as Light, Shadow as Shadow
from .optics import Optics as Optics, irradiance as irradiance
from .paper import Paper as Paper
from .render import camera_picture as camera_picture, delivered_picture as delivered_picture
from .scene import SheetScene as SheetScene, radiance as radiance
from .sensor import Sensor as Sensor
from .surfaces import Cone as Cone, Cylinder as Cylinder, Twisted as Twisted
