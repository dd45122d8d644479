"""What commands, options and keys of trinoc.toml of before are typed as now."""

import re
from collections.abc import Sequence

from trinoc.cli.command import UsageError

COMMANDS = {
    "doctor": "trinoc --version",
    "import": "trinoc export FILE --from FORMAT -o OUT",
    "wireframe": "trinoc match ... --steps wireframe",
}

_FIND = {
    "tolerance-px": "--find tolerance_px=PX",
    "false-alarms": "--find false_alarms=NUMBER",
    "least-contrast": "--find least_contrast=LEVELS",
    "arcs": "--find arcs=yes",
    "response": "--find response=srgb",
}
_SIGMA = {
    "print-scale-sigma": "--sigma print_scale=X,Y",
    "flatness-mm": "--sigma flatness_mm=MM",
}
_LENS = "--lens-mm FOCAL WIDTH HEIGHT"
OPTIONS: dict[str, dict[str, str]] = {
    "pattern": {
        "board": "trinoc pattern KIND",
        "square-mm": "trinoc pattern KIND square_mm=MM",
        "marker-mm": "trinoc pattern charuco marker_mm=MM",
        "tag-mm": "trinoc pattern aprilgrid tag_mm=MM",
        "tag-spacing": "trinoc pattern aprilgrid spacing=RATIO",
        "dictionary": "trinoc pattern KIND dictionary=NAME",
        "first": "trinoc pattern KIND first=N",
        "line-style": "trinoc pattern sheet line_style=stop|through|white",
        "for-distance-mm": "--camera distance_mm=MM field_deg=DEG size_px=W,H",
        "field-deg": "--camera distance_mm=MM field_deg=DEG size_px=W,H",
        "image-size-px": "--camera distance_mm=MM field_deg=DEG size_px=W,H",
        "screen-px": "--screen size_px=W,H diagonal_inch=INCH",
        "screen-inch": "--screen size_px=W,H diagonal_inch=INCH",
        "screen-pitch-mm": "--screen size_px=W,H pitch_mm=MM",
    },
    "watch": {"no-page": "--port none"},
    "intrinsics": {
        "principal-point": "--hold principal-point, or nothing where it is free",
        "aspect": "--hold aspect, or nothing where it is free",
    },
    "calibrate": {
        "focal-length-mm": _LENS,
        "pixel-pitch-mm": _LENS,
        "lens-exact": "--sigma lens=0",
        "no-lens-covariance": "--sigma lens=0",
        **_SIGMA,
        "aim-sigma-mm": "--sigma aim_mm=MM",
        "parameters": "--pose-model aimed (of 4) or aim-free (of 6)",
    },
    "calibrate-rig": _SIGMA,
    "match": {
        **_FIND,
        "guided": "--steps guided",
        "measure": "--steps pixels",
        "cylinders": "--steps cylinders",
        "rims": "--steps rims",
        "rims-out": "--steps rims, which are written beside the matches",
        "shadows": "--steps shadows",
    },
    "batch": {**_FIND, "threads": "--workers N", "scheduler": "--workers tcp://HOST:PORT"},
    "refine": {"intrinsics": "--free-lens"},
    "evaluate": {
        **{name: _FIND[name] for name in ("tolerance-px", "false-alarms", "least-contrast")},
        "least-posterior": "--lines least_posterior=0,0.5",
        "stages": "--lines stage=all,trinocular",
        "forms": "--lines form=tracks,joined",
        "unit-mm": "--shape unit_mm=MM",
        "crease-deg": "--shape crease_deg=DEG",
        "grey-step": "--shape grey_step=LEVELS",
    },
    "export": {"lenses": "--lens FILE"},
}
KEYS = {"pictures": "images"}


def refuse_old_names(arguments: Sequence[str]) -> None:
    """Raise UsageError, which says the new spelling, for a command or option of before."""
    if not arguments:
        return
    command = arguments[0]
    if command in COMMANDS:
        raise UsageError(f"{command} is now: {COMMANDS[command]}")
    for word in arguments[1:]:
        given = re.match(r"--([\w-]+)", word)
        old = given[1].replace("_", "-") if given else ""
        if old in OPTIONS.get(command, {}):
            raise UsageError(f"--{old} of trinoc {command} is now: {OPTIONS[command][old]}")
