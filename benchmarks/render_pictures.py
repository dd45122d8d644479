"""Make pictures of the sheet and of block scenes with POV-Ray, and their truth.

    python benchmarks/render_pictures.py sheets [--out trinoc/synth/demo]
    python benchmarks/render_pictures.py demo [--out trinoc/synth/demo]
    python benchmarks/render_pictures.py pov-sheet FILE
    python benchmarks/render_pictures.py blocks OUT --seeds 0 1 2 [--resolution 4]
        [--no-shadows] [--sharp]
    python benchmarks/render_pictures.py colours OUT --seeds 0 1 2

All but `sheets` need the program povray (Debian: apt-get install povray); nothing else in trinoc
does.

`sheets` makes the bundled pictures of the default sheet (sheet_<view>.png, pattern.json) by
`simulation.camera_picture`, as the rig of the paper's Table 1 sees it, 512 x 480 pixels that are
not square. `demo` makes these and the scene: a table with boxes, a wedge, an L-shaped block and a
cylinder (scene_<view>.png, truth.json). Noise is drawn by the number of the view, 0 to 2.

`pov-sheet` makes the left camera's picture of the sheet by POV-Ray, which the tests compare.

`blocks` makes one folder OUT/block_<seed> per seed with scene_<view>.png, rig.json,
shadows_<view>.png (the grey levels that shadows take away, without blur and noise),
clean_<view>.png (scene_<view>.png without noise, in 256ths of a grey level) and
truth.json: other solids, light, greys, blur (sigma 0.5 to 2 px) and noise (1 to 8 grey levels)
for every seed; --resolution 4 divides each pixel by four along both sides (2048 x 1920), and
--sharp makes the lamp a point.

`colours` makes the solids, greys and light of `blocks`, each face in a colour whose mean is its
grey, and writes light_<view>.png instead of scene_<view>.png: what falls on each pixel behind a
lens that blurs by 0.8 px, red, green and blue, 16 bits, linear, without noise.
benchmarks/delivered_scenes.py makes of it what cameras deliver.

truth.json (format "trinoc-scene-truth"; `trinoc.io.demo.load_scene_truth` reads it):
  edges_mm    ends of every edge of the solids, in the world's frame
  edge_kinds  "edge", or "rim" for a short chord of a cylinder's rim
  seen        per view: edge (index), extent (from, to along it, 0 to 1), and grey_step, the
              median difference of the grey levels a pixel to the left and to the right of the
              edge before blur and noise; parts are cut where it passes 8 levels
  silhouettes_mm  per view, the visible outlines of cylinders that are no edges
"""

import argparse
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pov_ray import Light, blocks_text, render, sheet_text

from simulation import block_scene
from simulation.camera_picture.delivery import quantise
from simulation.camera_picture.paper import Paper
from simulation.camera_picture.render import Condition, camera_picture
from simulation.camera_picture.scene import SheetScene
from simulation.camera_picture.sensor import Sensor
from simulation.scenes import Scene, demo_scene
from simulation.solids import Cylinder
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.camera import Camera
from trinoc.geometry.rig import Rig
from trinoc.io import save_scene_truth
from trinoc.io.board_json import save_pattern
from trinoc.io.rig_json import save_rig
from trinoc.synth import table1_rig
from trinoc.synth.truth import SceneTruth, SeenParts

DEMO = Path(__file__).parent.parent / "trinoc" / "synth" / "demo"
SHEET_MM = (210.0, 200.0)
# The noise of a CCD, as `write_image` has it: sigma 1.5 grey levels at 128, two thirds of the
# variance in proportion to the light. The light is even.
DEMO_SHEET = Condition(
    SheetScene(Paper(table=0.4, size_mm=SHEET_MM)),
    sensor=Sensor(read_levels=1.5 / 3**0.5, electrons_per_level=128 / 1.5),
)
DEMO_LIGHT = Light(
    key_from_mm=(-420.0, -330.0, 900.0), key=0.82, key_side_mm=330.0,
    fill_from_mm=(900.0, -500.0, 500.0), fill=0.34,
    second_fill_from_mm=(100.0, 900.0, 500.0), second_fill=0.14, ambient=0.14,
)  # fmt: skip
DEMO_GREYS = (0.80, 0.52, 0.70, 0.88, 0.60, 0.74)
DEMO_TABLE_GREY = 0.17
COLOUR_FOLD, COLOUR_BLUR_PX = 4, 0.8
# Across an edge the grey levels are taken this far to both sides, in pixels of the picture.
SIDE_PX = 1.0
SHOWN_STEP = 8.0


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    sheets = commands.add_parser("sheets", help="the bundled pictures of the sheet")
    demo = commands.add_parser("demo", help="the bundled pictures")
    for command in (sheets, demo):
        command.add_argument("--out", type=Path, default=DEMO, help="folder of the pictures")
    pov_sheet = commands.add_parser("pov-sheet", help="the sheet by POV-Ray")
    pov_sheet.add_argument("out", type=Path, help="the picture")
    blocks = commands.add_parser("blocks", help="scenes of blocks, one per seed")
    blocks.add_argument("out", type=Path, help="folder of the scenes; made if needed")
    blocks.add_argument(
        "--seeds", type=int, nargs="+", default=list(range(10)), help="one scene each"
    )
    blocks.add_argument(
        "--resolution", type=int, default=1, choices=(1, 2, 4), help="pixels per pixel"
    )
    blocks.add_argument("--no-shadows", action="store_true")
    blocks.add_argument("--sharp", action="store_true", help="the lamp is a point")
    colours = commands.add_parser("colours", help="scenes of coloured blocks, as light")
    colours.add_argument("out", type=Path, help="folder of the scenes; made if needed")
    colours.add_argument("--seeds", type=int, nargs="+", default=list(range(6)), help="one each")
    for command in (demo, pov_sheet, blocks, colours):
        command.add_argument("--threads", type=int, default=2, help="of POV-Ray")
    arguments = parser.parse_args()
    if arguments.command == "sheets":
        make_sheets(arguments.out)
    elif arguments.command == "demo":
        make_sheets(arguments.out)
        make_demo_scene(arguments.out, arguments.threads)
    elif arguments.command == "pov-sheet":
        text = sheet_text(Pattern.default(), size_mm=SHEET_MM, paper=0.92, ink=0.09, table=0.40)
        grey = render(text, table1_rig()["left"], fold=8, threads=arguments.threads)
        write_image(arguments.out, grey, fold=8, blur_px=0.7, noise=1.5, seed=1)
    elif arguments.command == "colours":
        for seed in arguments.seeds:
            make_colours(arguments.out, seed, arguments.threads)
    else:
        for seed in arguments.seeds:
            make_blocks(
                arguments.out, seed, arguments.resolution, arguments.threads,
                shadows=not arguments.no_shadows, sharp=arguments.sharp,
            )  # fmt: skip


def make_sheets(out: Path) -> None:
    """The demo's pictures of the sheet."""
    out.mkdir(parents=True, exist_ok=True)
    pattern = Pattern.default()
    save_pattern(pattern, out / "pattern.json")
    for seed, (view, camera) in enumerate(table1_rig().items()):
        picture = camera_picture(pattern, camera, DEMO_SHEET, seed=seed)
        cv2.imwrite(str(out / f"sheet_{view}.png"), picture)


def make_demo_scene(out: Path, threads: int) -> None:
    """The demo's scene of blocks."""
    scene, rig = demo_scene(), table1_rig()
    greys = face_greys(scene, DEMO_GREYS, np.random.default_rng(7), spread=0.05)
    make_scene(
        out, scene, rig, blocks_text(scene, greys, DEMO_TABLE_GREY, DEMO_LIGHT),
        blur_px=0.7, noise=1.5, seed=10, fold=4, threads=threads, about={},
    )  # fmt: skip


def make_blocks(
    out: Path,
    seed: int,
    resolution: int,
    threads: int,
    *,
    shadows: bool = True,
    sharp: bool = False,
) -> None:
    """Make one block scene, whose solids, light and greys are drawn by `seed`."""
    folder = out / f"block_{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    rig, scene = table1_rig(resolution=resolution), block_scene(seed)
    generator = np.random.default_rng([seed, 1])
    greys, table, light = greys_and_light(scene, generator)
    light = light._replace(shadows=shadows)
    light = light._replace(key_side_mm=0.0) if sharp else light
    text = blocks_text(scene, greys, table, light)
    bare_text = blocks_text(scene, greys, table, light._replace(shadows=False))
    blur, noise = float(generator.uniform(0.5, 2.0)), float(np.exp(generator.uniform(0, np.log(8))))
    save_rig(rig, folder / "rig.json")
    make_scene(
        folder, scene, rig, text, blur_px=round(blur, 3), noise=round(noise, 3), seed=100 * seed,
        fold=4 // min(resolution, 2), threads=threads, about={"seed": seed},
        bare_text=bare_text if shadows else None,
    )  # fmt: skip


def make_colours(out: Path, seed: int, threads: int) -> None:
    """Make the scene of `make_blocks` in colours: the light on each pixel, and the truth."""
    folder = out / f"block_{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    rig, scene = table1_rig(), block_scene(seed)
    greys, table, light = greys_and_light(scene, np.random.default_rng([seed, 1]))
    generator = np.random.default_rng([seed, 2])
    colours = [coloured(grey, generator) for grey in greys]
    text = blocks_text(scene, colours, table, light)
    parts_by_view = {}
    for view, camera in rig.items():
        fine = render(text, camera, fold=COLOUR_FOLD, threads=threads, colour=True)
        light_levels = 257 * exposed_pixels(fine, fold=COLOUR_FOLD, blur_px=COLOUR_BLUR_PX)
        levels = np.clip(np.rint(light_levels), 0, 65535).astype(np.uint16)
        cv2.imwrite(str(folder / f"light_{view}.png"), levels[..., ::-1])
        parts_by_view[view] = seen_parts(scene, camera, fine.mean(axis=-1), fold=COLOUR_FOLD)
    save_rig(rig, folder / "rig.json")
    truth = SceneTruth(scene.edges_mm, scene.edge_kinds, parts_by_view)
    save_scene_truth(truth, folder / "truth.json", {"seed": seed, "blur_px": COLOUR_BLUR_PX})


def greys_and_light(
    scene: Scene, generator: np.random.Generator
) -> tuple[list[np.ndarray], float, Light]:
    """The reflectances of faces and of the table, and the light."""
    contrast = float(generator.uniform(0.5, 1.3))
    mean_greys = np.clip(0.62 + 0.22 * contrast * generator.uniform(-1, 1, len(scene.solids)), 0, 1)
    greys = face_greys(scene, mean_greys, generator, spread=0.06 * contrast)
    return greys, float(generator.uniform(0.25, 0.6)), random_light(generator, contrast)


def coloured(greys: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """(faces, 3) reflectances of one solid: its random hue, at a saturation that stays valid."""
    hue = generator.normal(size=3)
    hue = (hue - hue.mean()) / np.ptp(hue)
    share = generator.uniform(0.2, 0.9) * np.minimum(greys - 0.02, 0.98 - greys)
    return greys[:, None] + share[:, None] * hue / np.abs(hue).max()


def make_scene(
    out: Path, scene: Scene, rig: Rig, text: str, *, blur_px: float, noise: float, seed: int,
    fold: int, threads: int, about: dict[str, Any], bare_text: str | None = None,
) -> None:  # fmt: skip
    """Make the pictures of a block scene from all cameras, and its truth.

    With `bare_text`, the scene without shadows, also the grey levels that shadows take away.
    """
    parts_by_view, silhouettes = {}, {}
    for offset, (view, camera) in enumerate(rig.items()):
        grey = render(text, camera, fold=fold, threads=threads)
        if bare_text is not None:
            write_shadows(out / f"shadows_{view}.png", text, bare_text, camera, threads)
        picture = out / f"scene_{view}.png"
        write_image(picture, grey, fold=fold, blur_px=blur_px, noise=noise, seed=seed + offset)
        if bare_text is not None:
            write_clean(out / f"clean_{view}.png", grey, fold=fold, blur_px=blur_px)
        parts_by_view[view] = seen_parts(scene, camera, grey, fold=fold)
        silhouettes[view] = np.round(scene.silhouettes_seen_by(camera), 6).tolist()
    truth = SceneTruth(scene.edges_mm, scene.edge_kinds, parts_by_view)
    about = {
        **about,
        "blur_px": blur_px,
        "noise_sigma_at_128": noise,
        "solids": [described(solid) for solid in scene.solids],
        "silhouettes_mm": silhouettes,
    }
    save_scene_truth(truth, out / "truth.json", about)


def write_shadows(path: Path, text: str, bare_text: str, camera: Camera, threads: int) -> None:
    """Write the light that shadows take from each pixel, without blur and noise, as 8 bits."""
    shaded, bare = (render(body, camera, fold=1, threads=threads) for body in (text, bare_text))
    cv2.imwrite(str(path), np.clip(np.rint(bare - shaded), 0, 255).astype(np.uint8))


def write_image(
    path: Path, grey: np.ndarray, *, fold: int, blur_px: float, noise: float, seed: int
) -> None:
    """Write the sensor's picture of fine grey levels: blur, pixel box, noise, 8 bits.

    The noise of a CCD grows with the light: its variance is a third constant, two thirds in
    proportion to the grey level, and `noise` is its sigma at 128.
    """
    pixels = exposed_pixels(grey, fold=fold, blur_px=blur_px)
    sigma = noise * np.sqrt((1 + 2 * np.maximum(pixels, 0.0) / 128.0) / 3)
    noisy = pixels + sigma * np.random.default_rng(seed).normal(size=pixels.shape)
    cv2.imwrite(str(path), quantise(noisy / 255.0, 8))


def write_clean(path: Path, grey: np.ndarray, *, fold: int, blur_px: float) -> None:
    """Write the picture without noise, in 256ths of a grey level, 16 bits."""
    pixels = exposed_pixels(grey, fold=fold, blur_px=blur_px)
    cv2.imwrite(str(path), np.clip(np.rint(256 * pixels), 0, 65535).astype(np.uint16))


def exposed_pixels(grey: np.ndarray, *, fold: int, blur_px: float) -> np.ndarray:
    """Camera pixels: blurred by a Gaussian of `blur_px` and averaged over fold x fold."""
    blurred = cv2.GaussianBlur(grey, (0, 0), blur_px * fold, borderType=cv2.BORDER_REPLICATE)
    height, width = (side // fold for side in grey.shape[:2])
    return blurred.reshape(height, fold, width, fold, *grey.shape[2:]).mean(axis=(1, 3))


def face_greys(
    scene: Scene, mean_greys: Any, generator: np.random.Generator, *, spread: float
) -> list[np.ndarray]:
    """A reflectance for each face: the solid's, and a little of its own."""
    greys = []
    for solid, mean in zip(scene.solids, mean_greys, strict=True):
        count = 1 if isinstance(solid, Cylinder) else len(solid.faces)
        greys.append(np.clip(mean + spread * generator.uniform(-1, 1, count), 0.03, 0.97))
    return greys


def random_light(generator: np.random.Generator, contrast: float) -> Light:
    """A soft lamp from a random side above, and weaker light from two others."""
    azimuth, height = generator.uniform(0, 2 * np.pi), generator.uniform(0.9, 1.25)
    side = azimuth + generator.uniform(1.6, 2.6)

    def lamp(angle: float, elevation: float) -> tuple[float, float, float]:
        flat = 1100.0 * np.cos(elevation)
        return (
            float(flat * np.cos(angle)),
            float(flat * np.sin(angle)),
            float(1100.0 * np.sin(elevation)),
        )

    key = 0.55 + 0.1 * contrast
    return Light(
        key_from_mm=lamp(azimuth, height), key=key,
        key_side_mm=float(generator.uniform(200.0, 450.0)),
        fill_from_mm=lamp(side, 0.45), fill=float(generator.uniform(0.15, 0.3)),
        second_fill_from_mm=lamp(2 * side - azimuth, 0.6),
        second_fill=float(generator.uniform(0.04, 0.12)),
        ambient=float(generator.uniform(0.06, 0.16)),
    )  # fmt: skip


def described(solid: Any) -> dict[str, Any]:
    """Record of a solid for truth.json."""
    if isinstance(solid, Cylinder):
        return {
            "kind": solid.kind,
            "base_centre_mm": solid.base_centre_mm.tolist(),
            "radius_mm": solid.radius_mm,
            "height_mm": solid.height_mm,
        }
    return {
        "kind": solid.kind,
        "vertices_mm": np.round(solid.vertices_mm, 6).tolist(),
        "faces": [list(face) for face in solid.faces],
    }


def seen_parts(scene: Scene, camera: Camera, grey: np.ndarray, *, fold: int) -> SeenParts:
    """Parts of the edges, cut where the step across them passes 8 grey levels.

    `grey` is the picture before blur and noise, fold x fold of its pixels in one of the
    camera's. Samples are a pixel apart or less; a part's step is the median of its samples.
    """
    visible = scene.seen_by(camera)
    rows = []
    for edge, (start, end) in zip(visible.segment, visible.extent, strict=True):
        first, second = scene.edges_mm[edge]
        ends = project_all(camera, np.stack([first, second]))
        length = np.hypot(*(ends[1] - ends[0])) * (end - start)
        count = max(2, int(np.ceil(length)))
        borders = np.linspace(start, end, count + 1)
        middle = (borders[:-1] + borders[1:]) / 2
        uv = project_all(camera, first + middle[:, None] * (second - first))
        along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
        # v points down: on the picture, left of the direction (du, dv) is (dv, -du).
        left = SIDE_PX * np.array([along[1], -along[0]])
        step = _sample(grey, uv + left, fold) - _sample(grey, uv - left, fold)
        shown = np.abs(step) >= SHOWN_STEP
        cuts = np.flatnonzero(np.diff(shown)) + 1
        for low, high in zip([0, *cuts], [*cuts, count], strict=True):
            rows.append((edge, borders[low], borders[high], float(np.median(step[low:high]))))
    table = np.array(rows).reshape(-1, 4)
    return SeenParts(table[:, 0].astype(np.int64), table[:, 1:3].copy(), table[:, 3].copy())


def project_all(camera: Camera, points_mm: np.ndarray) -> np.ndarray:
    """(n, 2) pixels of points in space, for a lens without distortion."""
    image = points_mm @ camera.matrix_px[:, :3].T + camera.matrix_px[:, 3]
    return image[:, :2] / image[:, 2:]


def _sample(grey: np.ndarray, uv_px: np.ndarray, fold: int) -> np.ndarray:
    folded = ((uv_px + 0.5) * fold - 0.5).astype(np.float32)
    return cv2.remap(
        grey.astype(np.float32), folded[None], None, cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )[0].astype(np.float64)  # fmt: skip


if __name__ == "__main__":
    main()
