"""`trinoc doctor`: is this installation as it should be?"""

import dataclasses
import importlib.metadata
import os
import platform
from pathlib import Path
from typing import Any, NamedTuple

from trinoc.cli.command import Command, Outcome

LIBRARIES = (
    *("trinoc", "numpy", "scipy", "jax", "jaxlib", "equinox", "optimistix", "lineax"),
    *("opencv-python-headless", "scikit-image", "tyro", "jinja2"),
)
EXTRAS = {
    "print": ("reportlab",),
    "plot": ("matplotlib",),
    "notebook": ("plotly", "pandas"),
    "batch": ("dask", "distributed"),
    "export": ("ruamel.yaml",),
    "parquet": ("pyarrow",),
    "view": ("viser",),
}
# All of these install the module cv2, each over the others.
OPENCV = (
    *("opencv-python", "opencv-python-headless", "opencv-contrib-python"),
    "opencv-contrib-python-headless",
)


class Finding(NamedTuple):
    """What was looked at, what was found, and what to do where that is not well."""

    name: str
    found: str
    remedy: str = ""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Doctor(Command):
    """Say what is installed, where kernels are kept, and whether a small job comes out right."""

    def run(self, command_line: str) -> Outcome:
        """Look, and try."""
        findings = [*_versions(), *_opencv(), _cache(), *_devices(), *_self_test()]
        width = max(len(finding.name) for finding in findings)
        lines = [
            f"{f.name:<{width}}  {f.found}"
            + (f"\n{'':<{width}}  -> {f.remedy}" if f.remedy else "")
            for f in findings
        ]
        ill = [finding for finding in findings if finding.remedy]
        lines.append("all is well" if not ill else f"{len(ill)} to mend, marked with ->")
        record: dict[str, Any] = {
            "findings": {finding.name: finding.found for finding in findings},
            "to_mend": {finding.name: finding.remedy for finding in ill},
        }
        refusal = f"{ill[0].name}: {ill[0].found}: {ill[0].remedy}" if ill else None
        return Outcome("\n".join(lines), record, refusal)


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _versions() -> list[Finding]:
    import trinoc

    found = [Finding("python", f"{platform.python_version()} on {platform.platform()}")]
    for name in LIBRARIES:
        version = trinoc.__version__ if name == "trinoc" else _version(name)
        remedy = "" if version or name in OPENCV else f"pip install {name}"
        found.append(Finding(name, version or "not installed", remedy))
    for extra, names in EXTRAS.items():
        missing = [name for name in names if _version(name) is None]
        words = "installed" if not missing else f"not installed (pip install 'trinoc[{extra}]')"
        found.append(Finding(f"extra {extra}", words))
    return found


def _opencv() -> list[Finding]:
    installed = [name for name in OPENCV if _version(name) is not None]
    if len(installed) < 2:
        return [Finding("cv2", installed[0] if installed else "of no known wheel")]
    return [
        Finding(
            "cv2",
            f"{len(installed)} wheels bring it: {', '.join(installed)}",
            f"pip uninstall -y {' '.join(installed)} && pip install opencv-python-headless",
        )
    ]


def _cache() -> Finding:
    from trinoc.io import COMPILE_CACHE_VARIABLE, enable_compile_cache

    folder = enable_compile_cache()
    if folder is None:
        off = os.environ.get(COMPILE_CACHE_VARIABLE, "").lower() in ("off", "0", "no")
        remedy = (
            "" if off else f"set {COMPILE_CACHE_VARIABLE} to a folder that only you can write to"
        )
        return Finding("compile cache", "off" if off else "cannot be used", remedy)
    files = [file for file in Path(folder).rglob("*") if file.is_file()]
    size = sum(file.stat().st_size for file in files) / 2**20
    return Finding("compile cache", f"{folder}: {len(files)} kernels, {size:.0f} MB")


def _devices() -> list[Finding]:
    import jax

    devices = ", ".join(f"{d.platform} {d.device_kind}" for d in jax.devices())
    return [Finding("devices of JAX", devices), Finding("processors", str(os.cpu_count()))]


def _self_test() -> list[Finding]:
    """The four edges of a square, found where they are; a point in space, found again."""
    import numpy as np

    from trinoc.geometry import triangulate_point
    from trinoc.numerics import in_float64
    from trinoc.segments import find_segments
    from trinoc.synth import table1_rig

    picture = np.full((96, 96), 60, np.uint8)
    picture[24:72, 24:72] = 200
    ends = np.asarray(find_segments(picture).endpoints_px)
    off = np.abs(np.abs(ends - 47.5).max(axis=-1) - 24.0).max() if len(ends) == 4 else np.inf
    segments = Finding(
        "self-test, segments",
        f"{len(ends)} edges of a square, off by {off:.3f} px",
        "" if off < 0.1 else "reinstall numpy and opencv-python-headless",
    )
    matrices, place = table1_rig().matrices_px, np.array([10.0, -20.0, 30.0])
    images = matrices @ np.append(place, 1.0)
    found = in_float64(triangulate_point)(matrices, images[:, :2] / images[:, 2:], np.ones(3))
    error = float(np.abs(np.asarray(found) - place).max())
    space = Finding(
        "self-test, space",
        f"a point of three views, off by {error:.1e} mm",
        "" if error < 1e-6 else "reinstall jax and jaxlib",
    )
    return [segments, space]
