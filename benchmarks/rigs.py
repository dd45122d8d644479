"""Rigs and lenses from many shots: errors over the bound, over claimed sigmas, of held-out shots.

    python benchmarks/rigs.py made [--trials N] [--shots N]        detected places, three cameras
    python benchmarks/rigs.py pixels [--trials N] [--scenes N] [--board NAME] [--fisheye]
    python benchmarks/rigs.py board-sets [--trials N] [--shots N]  boards that are fixed together
    python benchmarks/rigs.py splines [--trials N] [--shots N] [--bump PX]   a lens with a bump
    TRINOC_DATA=DIR python benchmarks/rigs.py held-out [--pixels]  real stereo sets

Each table is a file of benchmarks/rig_parts, whose docstring says what is made and printed. OpenCV
and, where it is installed, mrcal get the same observations.
"""

import argparse
import os
from pathlib import Path

from rig_parts import board_sets, held_out, made, pixels, splines


def main() -> None:
    """Print the tables of one part."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="part", required=True)
    for name, trials, shots in (("made", 10, 10), ("board-sets", 10, 12), ("splines", 4, 20)):
        part = commands.add_parser(name)
        part.add_argument("--trials", type=int, default=trials)
        part.add_argument("--shots", type=int, default=shots)
    commands.choices["splines"].add_argument("--bump", type=float, default=1.0, help="px")
    part = commands.add_parser("pixels")
    part.add_argument("--trials", type=int, default=3)
    part.add_argument("--scenes", type=int, default=2)
    part.add_argument("--board", choices=tuple(pixels.BOARDS))
    part.add_argument("--fisheye", action="store_true")
    commands.add_parser("held-out").add_argument("--pixels", action="store_true")
    options = parser.parse_args()
    match options.part:
        case "made":
            made.run(options.trials, options.shots)
        case "board-sets":
            board_sets.run(options.trials, options.shots)
        case "splines":
            splines.run(options.trials, options.shots, options.bump)
        case "pixels":
            pixels.run(options.board, options.scenes, options.trials, fisheye=options.fisheye)
        case "held-out":
            if "TRINOC_DATA" not in os.environ:
                raise SystemExit("Set TRINOC_DATA to the folder that holds stereo_chessboard.")
            held_out.run(Path(os.environ["TRINOC_DATA"]), pixels=options.pixels)


if __name__ == "__main__":
    main()
