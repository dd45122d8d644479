"""`trinoc --version`: which trinoc this is, what it stands on, and what is not as it should be."""

import importlib.metadata
import os
import platform

LIBRARIES = (
    *("numpy", "scipy", "jax", "jaxlib", "equinox", "optimistix", "lineax"),
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


def installation() -> tuple[str, list[str]]:
    """(what is installed, a line each; what to do where that is not well)."""
    import jax

    import trinoc
    from trinoc.io import COMPILE_CACHE_VARIABLE, enable_compile_cache

    found = {"python": f"{platform.python_version()} on {platform.platform()}"}
    found |= {name: _version(name) or "not installed" for name in LIBRARIES}
    for extra, names in EXTRAS.items():
        missing = [name for name in names if _version(name) is None]
        found[f"extra {extra}"] = f"pip install 'trinoc[{extra}]'" if missing else "installed"
    found["devices"] = ", ".join(f"{d.platform} {d.device_kind}" for d in jax.devices())
    folder = enable_compile_cache()
    off = os.environ.get(COMPILE_CACHE_VARIABLE, "").lower() in ("off", "0", "no")
    found["compile cache"] = str(folder or ("off" if off else "cannot be used"))

    remedies = [
        f"pip install {name}"
        for name in LIBRARIES
        if found[name] == "not installed" and name not in OPENCV
    ]
    wheels = [name for name in OPENCV if _version(name) is not None]
    if len(wheels) > 1:
        remedies.append(
            f"{len(wheels)} wheels bring cv2: pip uninstall -y {' '.join(wheels)} && pip install "
            "opencv-python-headless"
        )
    if folder is None and not off:
        remedies.append(f"set {COMPILE_CACHE_VARIABLE} to a folder that only you can write to")
    width = max(map(len, found))
    lines = [f"{name:<{width}}  {words}" for name, words in found.items()]
    return "\n".join([f"trinoc {trinoc.__version__}", *lines]), remedies


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
