"""Pictures of the sheet as benches take them: one function a condition, of a random pose."""

import os
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from simulation.camera_picture.layers import Paint, cover_card, finger
from simulation.camera_picture.light import Illumination, Shadow
from simulation.camera_picture.render import render_sheet
from simulation.camera_picture.shapes import Capsule, FilledCircle
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.synth import table1_lens

# Enough for labels; the renderer's own error is then about that of the centres, so that errors
# over sigma are twice too large. At 16 they are right, and pictures take eight times as long.
SUPERSAMPLING = int(os.environ.get("SUPERSAMPLING", "4"))


class Scene(NamedTuple):
    pattern: Pattern
    camera: Camera
    picture: np.ndarray
    refused: bool = False


def pose(
    random: np.random.Generator,
    pattern: Pattern,
    *,
    obliquity_deg: tuple[float, float] = (5.0, 50.0),
    filled: tuple[float, float] = (0.5, 0.95),
    area: tuple[float, float] | None = None,
    lens: Intrinsics | None = None,
) -> Camera:
    """A camera at a random pose, with the complete sheet in view.

    filled : range of the sheet's larger share of the picture's width or height.
    area : range of the sheet's share of the picture's area instead.
    """
    lens = table1_lens() if lens is None else lens
    pan, swing = random.uniform(-180, 180, 2)
    tilt = 90.0 - random.uniform(*obliquity_deg)
    wanted = random.uniform(*(filled if area is None else area))
    half = float(np.abs(pattern.centres_mm).max() + pattern.radius_mm.max())
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    distance = 300.0
    for _ in range(30):
        camera = Camera.from_degrees(
            lens, pan_deg=pan, tilt_deg=tilt, swing_deg=swing, distance_mm=distance
        )
        corners_px = project(camera, corners)
        size = np.array(lens.image_size_px)
        if area is None:
            share = float(np.max(np.abs(corners_px - (size - 1) / 2) / (size / 2)))
            factor = share / wanted
        else:
            x, y = corners_px.T
            polygon = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
            factor = np.sqrt(polygon / size.prod() / wanted)
        distance = max(distance * factor**0.8, 1.3 * half)
    return camera


def project(camera: Camera, points_mm: np.ndarray) -> np.ndarray:
    homogeneous = np.column_stack([points_mm, np.zeros(len(points_mm)), np.ones(len(points_mm))])
    image = homogeneous @ np.asarray(camera.matrix_px, dtype=float).T
    return image[:, :2] / image[:, 2:]


def render(
    random: np.random.Generator, pattern: Pattern, camera: Camera, **changes: Any
) -> np.ndarray:
    settings: dict[str, Any] = {
        "blur_px": 0.7,
        "noise_sigma": 2.0,
        "supersampling": SUPERSAMPLING,
        "table": float(random.uniform(40, 200)),
        "seed": int(random.integers(2**31)),
    }
    return render_sheet(pattern, camera, **(settings | changes))


def bench(random: np.random.Generator) -> Scene:
    pattern = Pattern.default()
    camera = pose(random, pattern)
    return Scene(pattern, camera, render(random, pattern, camera))


def tilted(random: np.random.Generator) -> Scene:
    pattern = Pattern.default()
    camera = pose(random, pattern, obliquity_deg=(60.0, 75.0), filled=(0.8, 0.97))
    return Scene(pattern, camera, render(random, pattern, camera))


def blurred(random: np.random.Generator) -> Scene:
    pattern = Pattern.default()
    camera = pose(random, pattern, filled=(0.75, 0.97))
    return Scene(pattern, camera, render(random, pattern, camera, blur_px=random.uniform(0.4, 4)))


def noisy(random: np.random.Generator) -> Scene:
    pattern = Pattern.default()
    camera = pose(random, pattern)
    noise = random.uniform(5, 15)
    return Scene(pattern, camera, render(random, pattern, camera, noise_sigma=noise))


def faint(random: np.random.Generator) -> Scene:
    pattern = Pattern.default()
    camera = pose(random, pattern)
    paper = random.uniform(60, 230)
    ink = paper - random.uniform(20, 40)
    picture = render(random, pattern, camera, paper=paper, ink=ink)
    return Scene(pattern, camera, picture)


def uneven_light(random: np.random.Generator) -> Scene:
    pattern = Pattern.default()
    camera = pose(random, pattern)
    light = sloping_light(random, 0.3, 0.8)
    return Scene(pattern, camera, render(random, pattern, camera, paper=160.0, light=light))


def sloping_light(random: np.random.Generator, low: float, high: float) -> Illumination:
    """Light that increases by a share of `low` to `high` in 100 mm, in a random direction."""
    angle, slope = random.uniform(0, 2 * np.pi), random.uniform(low, high)
    return Illumination((float(slope * np.cos(angle)), float(slope * np.sin(angle))))


def shaded(random: np.random.Generator) -> Scene:
    pattern = Pattern.default()
    camera = pose(random, pattern)
    direction_deg = float(random.uniform(0, 360))
    point_x, point_y = map(float, random.uniform(-60, 60, 2))
    edge = Shadow(
        (point_x, point_y),
        direction_deg,
        light_left=float(random.uniform(0.35, 0.7)),
        penumbra_mm=float(random.uniform(0.2, 10)),
    )
    return Scene(
        pattern, camera, render(random, pattern, camera, light=Illumination(shadows=(edge,)))
    )


def covered(random: np.random.Generator) -> Scene:
    """Hands, cards and fingers until up to 40 % of the circles are touched."""
    pattern = Pattern.default()
    camera = pose(random, pattern)
    wanted = random.uniform(0.15, 0.4) * len(pattern)
    covers: tuple[Paint, ...] = ()
    for _ in range(12):
        position_mm, turn = random.uniform(-85, 85, 2), float(random.uniform(0, 360))
        grey = float(random.uniform(40, 200))
        kind = random.integers(3)
        more = (
            (cover_card(position_mm, turn_deg=turn, grey=grey),)
            if kind == 0
            else (finger(position_mm, turn, length_mm=90.0, grey=grey),)
            if kind == 1
            else hand(position_mm * 1.4, direction_deg=turn, grey=grey)
        )
        touched = touched_circles(pattern, covers + more)
        if touched <= 0.42 * len(pattern):
            covers += more
        if touched_circles(pattern, covers) >= wanted:
            break
    return Scene(pattern, camera, render(random, pattern, camera, covers=covers))


def hand(palm_mm: np.ndarray, *, direction_deg: float, grey: float) -> tuple[Paint, ...]:
    """A flat hand; `direction_deg` leads from the palm to the finger tips."""
    angle = np.radians(direction_deg)
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-np.sin(angle), np.cos(angle)])
    arm = Capsule(np.stack([palm_mm - 250 * along, palm_mm]), 30.0)
    parts = [Paint(arm, grey - 8), Paint(FilledCircle(palm_mm, 42.0), grey)]
    for offset_mm, length in ((-30.0, 62.0), (-10.0, 76.0), (10.0, 72.0), (30.0, 52.0)):
        tip = palm_mm + offset_mm * across + (34.0 + length) * along
        parts.append(finger(tip, direction_deg + 180.0, length_mm=length, grey=grey))
    thumb = palm_mm + 72.0 * across + 38.0 * along
    parts.append(finger(thumb, direction_deg + 215.0, length_mm=58.0, grey=grey))
    return tuple(parts)


def round_things(random: np.random.Generator, *, count: int, reach_mm: float) -> tuple[Paint, ...]:
    """Coins, washers and ink blots, 3 to 13 mm in radius, strewn at random."""
    parts: list[Paint] = []
    for _ in range(count):
        centre = random.uniform(-reach_mm, reach_mm, 2)
        radius, grey = float(random.uniform(3.0, 13.0)), float(random.uniform(15.0, 190.0))
        parts.append(Paint(FilledCircle(centre, radius), grey))
        if random.random() < 0.5:
            hole = float(random.uniform(0.3, 0.7)) * radius
            parts.append(Paint(FilledCircle(centre, hole), float(random.uniform(60.0, 250.0))))
    return tuple(parts)


def touched_circles(pattern: Pattern, layers: tuple[Paint, ...]) -> int:
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    reach = np.array([1.0, 0.5, 0.0])[:, None, None] * ring
    points = pattern.centres_mm[:, None] + pattern.radius_mm[0] * reach.reshape(-1, 2)
    grey = np.full(points.shape[:2], -1.0)
    for layer in layers:
        grey = layer.over(grey, points)
    return int(np.sum(np.any(grey != -1.0, axis=1)))


def small(random: np.random.Generator) -> Scene:
    pattern = Pattern.default()
    camera = pose(random, pattern, obliquity_deg=(5, 40), area=(0.08, 0.15))
    return Scene(pattern, camera, render(random, pattern, camera))


def cluttered(random: np.random.Generator) -> Scene:
    pattern = Pattern.default()
    camera = pose(random, pattern, filled=(0.4, 0.8))
    things = round_things(random, count=14, reach_mm=220.0)
    return Scene(pattern, camera, render(random, pattern, camera, covers=things))


def through(random: np.random.Generator) -> Scene:
    return crossed(random, "through")


def white(random: np.random.Generator) -> Scene:
    return crossed(random, "white")


def stop(random: np.random.Generator) -> Scene:
    return crossed(random, "stop")


def crossed(random: np.random.Generator, style: str) -> Scene:
    pattern = Pattern.cross_grid(rows=5, columns=5, pitch_mm=20, radius_mm=6, line_style=style)
    camera = pose(random, pattern, filled=(0.4, 0.95))
    return Scene(pattern, camera, render(random, pattern, camera))


def deep(random: np.random.Generator) -> Scene:
    pattern = Pattern.default()
    camera = pose(random, pattern)
    picture = render(random, pattern, camera, bits=16)
    return Scene(pattern, camera, picture)


def large(random: np.random.Generator) -> Scene:
    """Pictures of 3072 x 2880 pixels."""
    pattern = Pattern.default()
    lens = table1_lens(resolution=6)
    camera = pose(random, pattern, lens=lens)
    return Scene(pattern, camera, render(random, pattern, camera, blur_px=1.5, supersampling=2))


def coloured(random: np.random.Generator) -> Scene:
    pattern = Pattern.default()
    camera = pose(random, pattern)
    tint = random.uniform(0.4, 1.0, 3)
    picture = render(random, pattern, camera, bits=None)
    noise = random.normal(0, 2, (*picture.shape, 3))
    return Scene(
        pattern, camera, np.rint((picture[..., None] * tint + noise).clip(0, 255)).astype("u1")
    )


def plain(random: np.random.Generator) -> Scene:
    """A grid of discs without rings or lines, 7 x 9."""
    pattern = Pattern.circle_grid(rows=7, columns=9, pitch_mm=18, radius_mm=5)
    camera = pose(random, pattern, filled=(0.4, 0.95))
    return Scene(pattern, camera, render(random, pattern, camera))


def bent(random: np.random.Generator) -> Scene:
    """A lens with barrel or cushion distortion."""
    pattern = Pattern.default()
    k1 = float(random.uniform(-0.35, 0.25))
    camera = pose(random, pattern, lens=table1_lens(distortion=(k1, 0.0, 0.0, 0.0)))
    return Scene(pattern, camera, render(random, pattern, camera))


def everything(random: np.random.Generator) -> Scene:
    """All disturbances at once, each of them small."""
    pattern = Pattern.default()
    camera = pose(random, pattern, obliquity_deg=(0, 60), filled=(0.6, 0.95))
    light = sloping_light(random, 0.0, 0.4)
    tip_mm, direction_deg = random.uniform(-80, 80, 2), float(random.uniform(0, 360))
    paper = random.uniform(120, 200)
    picture = render(
        random,
        pattern,
        camera,
        paper=paper,
        ink=paper * random.uniform(0.2, 0.6),
        blur_px=random.uniform(0.5, 2.0),
        noise_sigma=random.uniform(1, 6),
        light=light,
        covers=(finger(tip_mm, direction_deg, length_mm=90.0, grey=140.0),),
    )
    return Scene(pattern, camera, picture)


def mirrored(random: np.random.Generator) -> Scene:
    scene = bench(random)
    return scene._replace(picture=np.ascontiguousarray(scene.picture[:, ::-1]), refused=True)


def no_sheet(random: np.random.Generator) -> Scene:
    pattern = Pattern.default()
    camera = pose(random, pattern)
    blank = Pattern.circle_grid(rows=1, columns=1, pitch_mm=20, radius_mm=6)
    things = round_things(random, count=30, reach_mm=200.0)
    return Scene(pattern, camera, render(random, blank, camera, covers=things), refused=True)


def other_sheet(random: np.random.Generator) -> Scene:
    """A sheet whose rings differ from those of the requested pattern."""
    pattern = Pattern.default()
    rings = random.random((8, 8)) < 0.45
    other = Pattern.cross_grid(rows=8, columns=8, pitch_mm=20, radius_mm=6, rings=rings)
    camera = pose(random, pattern)
    return Scene(pattern, camera, render(random, other, camera), refused=True)


def two_sheets(random: np.random.Generator) -> Scene:
    pattern = Pattern.default()
    camera = pose(random, pattern)
    picture = render(random, pattern, camera)
    return Scene(pattern, camera, np.concatenate([picture, picture], axis=1), refused=True)


CONDITIONS: dict[str, Callable[[np.random.Generator], Scene]] = {
    make_scene.__name__: make_scene
    for make_scene in (
        bench,
        tilted,
        blurred,
        noisy,
        faint,
        uneven_light,
        shaded,
        covered,
        small,
        cluttered,
        through,
        white,
        stop,
        deep,
        large,
        coloured,
        plain,
        bent,
        everything,
        mirrored,
        no_sheet,
        other_sheet,
        two_sheets,
    )
}
