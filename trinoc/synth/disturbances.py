"""What troubles a picture of the sheet: hands, cards, shade, glare, and round things about.

All are layers on the plane Z = 0 for `render_sheet(above=...)`, the first of them lowest.
"""

from collections.abc import Callable

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from trinoc.synth.coverage import coverage_of_cells, coverage_of_points
from trinoc.synth.layers import Layer, Paint
from trinoc.synth.shapes import Capsule, ConvexPolygon, Disc, Shape


class Surround(eqx.Module):
    """One grey outside a figure: the table round a sheet of paper."""

    shape: Shape
    grey: float

    @property
    def local(self) -> bool:
        """False: it fills the picture."""
        return False

    def over(
        self,
        grey: Float[np.ndarray, "*n"],
        points_mm: Float[np.ndarray, "*n 2"],
        *,
        cells: bool = False,
    ) -> Float[np.ndarray, "*n"]:
        """What was below inside the figure, the surround elsewhere."""
        level = self.shape.level_mm(points_mm)
        share = coverage_of_cells(level) if cells else coverage_of_points(level)
        return self.grey + share * (grey - self.grey)

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """The figure's outline."""
        return self.shape.outline_mm(step_mm)


class LightGradient(eqx.Module):
    """Light that rises in one direction: a factor of 1 + slope . (X, Y), never below 0."""

    slope_per_mm: Float[np.ndarray, "2"]

    @property
    def local(self) -> bool:
        """False: it fills the picture."""
        return False

    def over(
        self,
        grey: Float[np.ndarray, "*n"],
        points_mm: Float[np.ndarray, "*n 2"],
        *,
        cells: bool = False,
    ) -> Float[np.ndarray, "*n"]:
        """The grey levels in this light."""
        factor = 1 + np.einsum("...i,i->...", points_mm, self.slope_per_mm)
        return np.where(np.isfinite(factor), grey * np.maximum(factor, 0.0), grey)

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """Nothing: light without an edge."""
        return np.zeros((0, 2))


class ShadowEdge(eqx.Module):
    """Shade on one side of a straight edge, as an object outside the picture throws it.

    Fields
    ------
    point_mm : a point of the edge.
    normal : (2,) unit vector from the edge into the shade.
    factor : light left in the shade.
    penumbra_mm : sigma of the soft edge; below a tenth of a millimetre it is drawn as that.
    """

    point_mm: Float[np.ndarray, "2"]
    normal: Float[np.ndarray, "2"]
    factor: float
    penumbra_mm: float

    @property
    def local(self) -> bool:
        """False: the shade reaches to the horizon."""
        return False

    def over(
        self,
        grey: Float[np.ndarray, "*n"],
        points_mm: Float[np.ndarray, "*n 2"],
        *,
        cells: bool = False,
    ) -> Float[np.ndarray, "*n"]:
        """The grey levels in light and shade."""
        depth = np.einsum("...i,i->...", points_mm - self.point_mm, self.normal)
        shaded = ndtr(depth / max(self.penumbra_mm, 0.1))
        return np.where(np.isfinite(shaded), grey * (1 - (1 - self.factor) * shaded), grey)

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """The edge, a metre to both sides; as many lines beside it as the penumbra is wide."""
        along = np.array([-self.normal[1], self.normal[0]])
        line = self.point_mm + np.arange(-1000.0, 1000.0, step_mm)[:, None] * along
        reach = min(3 * max(self.penumbra_mm, 0.1), 3.0)
        beside = np.arange(-reach, reach + step_mm / 2, step_mm)
        return np.concatenate([line + offset * self.normal for offset in beside])


class Glare(eqx.Module):
    """A bright spot, the lamp's reflection: grey levels added, Gaussian in shape."""

    centre_mm: Float[np.ndarray, "2"]
    sigma_mm: float
    amount: float

    @property
    def local(self) -> bool:
        """False: the spot has no edge."""
        return False

    def over(
        self,
        grey: Float[np.ndarray, "*n"],
        points_mm: Float[np.ndarray, "*n 2"],
        *,
        cells: bool = False,
    ) -> Float[np.ndarray, "*n"]:
        """The grey levels with the spot on top; the sensor clips them later."""
        squared = np.sum((points_mm - self.centre_mm) ** 2, axis=-1)
        added = self.amount * np.exp(-squared / (2 * self.sigma_mm**2))
        return grey + np.nan_to_num(added)

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """Nothing: a spot without an edge."""
        return np.zeros((0, 2))


def table(size_mm: tuple[float, float], grey: float) -> tuple[Layer, ...]:
    """A table round a sheet of this size, centred on the origin; for `render_sheet(below=...)`."""
    return (Surround(ConvexPolygon.rectangle(np.zeros(2), size_mm), grey),)


def card(
    centre_mm: Float[np.ndarray, "2"],
    *,
    size_mm: tuple[float, float] = (85.6, 54.0),
    turn_deg: float = 0.0,
    grey: float = 150.0,
    stripe: float = 60.0,
) -> tuple[Layer, ...]:
    """A bank card with a dark stripe along one of its long sides."""
    body = ConvexPolygon.rectangle(centre_mm, size_mm, turn_deg)
    turn = np.radians(turn_deg)
    across = np.array([-np.sin(turn), np.cos(turn)])
    middle = centre_mm + 0.25 * size_mm[1] * across
    band = ConvexPolygon.rectangle(middle, (size_mm[0], 0.2 * size_mm[1]), turn_deg)
    return (Paint(body, grey), Paint(band, stripe))


def finger(
    tip_mm: Float[np.ndarray, "2"],
    *,
    direction_deg: float,
    length_mm: float = 90.0,
    width_mm: float = 17.0,
    grey: float = 140.0,
) -> tuple[Layer, ...]:
    """A finger and its nail; `direction_deg` leads from the tip into the hand."""
    angle = np.radians(direction_deg)
    along = np.array([np.cos(angle), np.sin(angle)])
    start = tip_mm + width_mm / 2 * along
    nail = np.stack([start, start + 0.35 * width_mm * along])
    return (
        Paint(Capsule(np.stack([start, start + length_mm * along]), width_mm / 2), grey),
        Paint(Capsule(nail, 0.3 * width_mm), min(grey + 25.0, 255.0)),
    )


def hand(
    palm_mm: Float[np.ndarray, "2"], *, direction_deg: float, grey: float = 135.0
) -> tuple[Layer, ...]:
    """A flat hand; `direction_deg` leads from the palm to the finger tips."""
    angle = np.radians(direction_deg)
    along, across = (
        np.array([np.cos(angle), np.sin(angle)]),
        np.array([-np.sin(angle), np.cos(angle)]),
    )
    arm = Capsule(np.stack([palm_mm - 250 * along, palm_mm]), 30.0)
    layers: list[Layer] = [Paint(arm, grey - 8), Paint(Disc(palm_mm, 42.0), grey)]
    for place, length in ((-30.0, 62.0), (-10.0, 76.0), (10.0, 72.0), (30.0, 52.0)):
        tip = palm_mm + place * across + (34.0 + length) * along
        layers += finger(tip, direction_deg=direction_deg + 180.0, length_mm=length, grey=grey)
    thumb = palm_mm + 72.0 * across + 38.0 * along
    layers += finger(thumb, direction_deg=direction_deg + 215.0, length_mm=58.0, grey=grey)
    return tuple(layers)


def round_things(seed: int, *, count: int = 4, reach_mm: float = 130.0) -> tuple[Layer, ...]:
    """Coins, washers and ink blots, 3 to 13 mm in radius, strewn at random."""
    generator = np.random.default_rng(seed)
    layers: list[Layer] = []
    for _ in range(count):
        centre = generator.uniform(-reach_mm, reach_mm, 2)
        radius, grey = float(generator.uniform(3.0, 13.0)), float(generator.uniform(15.0, 190.0))
        layers.append(Paint(Disc(centre, radius), grey))
        if generator.random() < 0.5:
            hole = float(generator.uniform(0.3, 0.7)) * radius
            layers.append(Paint(Disc(centre, hole), float(generator.uniform(60.0, 250.0))))
    return tuple(layers)


def random_disturbances(seed: int, *, reach_mm: float = 80.0) -> tuple[Layer, ...]:
    """One to three troubles drawn by `seed`; `reach_mm` is half the side of the pattern."""
    generator = np.random.default_rng(seed)
    makers: list[Callable[[np.random.Generator, float], tuple[Layer, ...]]] = [
        _random_hand,
        _random_card,
        _random_finger,
        _random_light,
        _random_shadow,
        _random_glare,
        _random_round_things,
    ]
    chosen = generator.permutation(len(makers))[: generator.integers(1, 4)]
    layers: list[Layer] = []
    for index in sorted(chosen):
        layers += makers[index](generator, reach_mm)
    return tuple(layers)


def _random_hand(generator: np.random.Generator, reach_mm: float) -> tuple[Layer, ...]:
    place, turn = generator.uniform(0.0, 360.0), generator.uniform(-25.0, 25.0)
    angle = np.radians(place)
    palm = generator.uniform(1.5, 2.0) * reach_mm * np.array([np.cos(angle), np.sin(angle)])
    grey = float(generator.uniform(70.0, 190.0))
    return hand(palm, direction_deg=float(place + 180.0 + turn), grey=grey)


def _random_card(generator: np.random.Generator, reach_mm: float) -> tuple[Layer, ...]:
    return card(
        generator.uniform(-reach_mm, reach_mm, 2),
        turn_deg=float(generator.uniform(0.0, 180.0)),
        grey=float(generator.uniform(40.0, 220.0)),
        stripe=float(generator.uniform(20.0, 120.0)),
    )


def _random_finger(generator: np.random.Generator, reach_mm: float) -> tuple[Layer, ...]:
    tip = generator.uniform(-reach_mm, reach_mm, 2)
    outward = np.degrees(np.arctan2(tip[1], tip[0])) + generator.uniform(-40.0, 40.0)
    grey = float(generator.uniform(70.0, 190.0))
    return finger(tip, direction_deg=float(outward), length_mm=200.0, grey=grey)


def _random_light(generator: np.random.Generator, reach_mm: float) -> tuple[Layer, ...]:
    angle, change = generator.uniform(0.0, 2 * np.pi), generator.uniform(0.2, 0.6)
    slope = change / (2 * reach_mm) * np.array([np.cos(angle), np.sin(angle)])
    return (LightGradient(slope),)


def _random_shadow(generator: np.random.Generator, reach_mm: float) -> tuple[Layer, ...]:
    angle = generator.uniform(0.0, 2 * np.pi)
    return (
        ShadowEdge(
            generator.uniform(-0.6 * reach_mm, 0.6 * reach_mm, 2),
            np.array([np.cos(angle), np.sin(angle)]),
            float(generator.uniform(0.35, 0.8)),
            float(generator.uniform(0.0, 6.0)),
        ),
    )


def _random_glare(generator: np.random.Generator, reach_mm: float) -> tuple[Layer, ...]:
    centre = generator.uniform(-reach_mm, reach_mm, 2)
    sigma, amount = generator.uniform(8.0, 25.0), generator.uniform(60.0, 400.0)
    return (Glare(centre, float(sigma), float(amount)),)


def _random_round_things(generator: np.random.Generator, reach_mm: float) -> tuple[Layer, ...]:
    seed, count = int(generator.integers(2**31)), int(generator.integers(2, 7))
    return round_things(seed, count=count, reach_mm=1.5 * reach_mm)
