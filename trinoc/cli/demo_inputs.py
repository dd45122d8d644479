"""`trinoc demo --keep-inputs`: the demo's pictures, and the commands that make its results."""

import shlex
import shutil
from pathlib import Path

# The demo's pictures are made: lens and print are exactly what is said of them.
LENS = ("--focal-length-mm", "16", "--pixel-pitch-mm", "0.0162", "0.0134", "--lens-exact")
PRINT = ("--print-scale-sigma", "0", "0")


def keep_inputs(folder: Path) -> list[Path]:
    """Write pictures, layout of the sheet and trinoc.toml beside the results."""
    from trinoc.io import demo_paths, demo_pattern, save, write_text

    inputs = folder / "inputs"
    inputs.mkdir(exist_ok=True)
    written = []
    for kind in ("sheet", "scene"):
        for view, path in demo_paths(kind).items():
            copy = inputs / f"{kind}_{view}{Path(path).suffix}"
            shutil.copyfile(path, copy)
            written.append(copy)
    save(demo_pattern(), inputs / "sheet.json")
    write_text(folder / "trinoc.toml", _toml())
    return [*written, inputs / "sheet.json", folder / "trinoc.toml"]


def commands() -> list[str]:
    """The command lines, to be run in the demo's folder, that make its rig and its matches."""
    sheets, scenes = (_pictures(kind) for kind in ("sheet", "scene"))
    named = [[f"{view}={file}" for view, file in files.items()] for files in (sheets, scenes)]
    lines = [
        ["trinoc", "calibrate", *named[0], "--pattern", "inputs/sheet.json", *LENS, *PRINT,
         "-o", "my-rig.json", "--report", "my-calibration.html"],
        ["trinoc", "match", *named[1], "--rig", "my-rig.json", "-o", "my-matches.npz",
         "--report", "my-matches.html"],
        ["trinoc", "export", "my-matches.npz", "--to", "ply", "-o", "my-segments.ply"],
    ]  # fmt: skip
    return [shlex.join(line) for line in lines]


def _pictures(kind: str) -> dict[str, str]:
    from trinoc.io import demo_paths

    return {
        view: f"inputs/{kind}_{view}{Path(path).suffix}" for view, path in demo_paths(kind).items()
    }


def _toml() -> str:
    """So that `trinoc calibrate` and `trinoc match` need no arguments there."""

    def table(files: dict[str, str]) -> str:
        return "{" + ", ".join(f'{view} = "{file}"' for view, file in files.items()) + "}"

    return f"""\
[calibrate]
pictures = {table(_pictures("sheet"))}
pattern = "inputs/sheet.json"
focal_length_mm = 16
pixel_pitch_mm = [0.0162, 0.0134]
lens_exact = true
print_scale_sigma = [0, 0]
out = "my-rig.json"

[match]
pictures = {table(_pictures("scene"))}
rig = "my-rig.json"
out = "my-matches.npz"
"""
