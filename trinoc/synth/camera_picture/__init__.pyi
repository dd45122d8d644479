from .delivery import Processing as Processing, Sharpening as Sharpening
from .layers import Paint as Paint, card as card, finger as finger
from .light import Lamp as Lamp, Light as Light, Shadow as Shadow
from .optics import Optics as Optics, irradiance as irradiance
from .paper import Paper as Paper
from .render import (
    Condition as Condition,
    camera_picture as camera_picture,
    delivered_picture as delivered_picture,
    render_sheet as render_sheet,
)
from .scene import Radiance as Radiance, SheetScene as SheetScene, radiance as radiance
from .sensor import Mosaic as Mosaic, Sensor as Sensor
from .shapes import (
    Capsule as Capsule,
    Cells as Cells,
    ConvexPolygon as ConvexPolygon,
    Disc as Disc,
)
from .surfaces import Cone as Cone, Cylinder as Cylinder, Surface as Surface, Twisted as Twisted
