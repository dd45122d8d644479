"""Joint refinement of cameras and matched lines: errors before and after, coverage, time.

    python benchmarks/refine.py made [--trials N]            disturbed rigs, matches given
    python benchmarks/refine.py matched [--trials N]         segments that the matcher joins
    TRINOC_DATA=DIR python benchmarks/refine.py photographs [--trials N] [--published-only]
    python benchmarks/refine.py times [--scipy-seconds N]    beside scipy

Each table is a file of benchmarks/refine_parts, whose docstring says what is made and printed.
"""

import argparse
import os
from pathlib import Path

from refine_parts import made, matched, photographs, times


def main() -> None:
    """Print the tables of one part."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="part", required=True)
    for name, trials in (("made", 20), ("matched", 6), ("photographs", 3)):
        commands.add_parser(name).add_argument("--trials", type=int, default=trials)
    commands.choices["photographs"].add_argument(
        "--published-only", action="store_true", help="no matching of our own"
    )
    commands.add_parser("times").add_argument("--scipy-seconds", type=int, default=480)
    options = parser.parse_args()
    match options.part:
        case "made":
            made.run(options.trials)
        case "matched":
            matched.run(options.trials)
        case "photographs":
            if "TRINOC_DATA" not in os.environ:
                raise SystemExit("Set TRINOC_DATA to the folder that holds vgg_merton1.")
            folder = Path(os.environ["TRINOC_DATA"])
            photographs.run(folder, options.trials, published_only=options.published_only)
        case "times":
            times.run(options.scipy_seconds)


if __name__ == "__main__":
    main()
