"""`trinoc --version`: the installed libraries, and what to do where they are not well."""

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
    "notebook": ("pandas",),
    "batch": ("dask", "distributed"),
    "export": ("ruamel.yaml",),
    "parquet": ("pyarrow",),
}
# All of these install the module cv2, each over the others.
OPENCV = (
    *("opencv-python", "opencv-python-headless", "opencv-contrib-python"),
    "opencv-contrib-python-headless",
)


def describe_installation() -> tuple[str, list[str]]:
    """Return the installed versions as text, and sentences on how to correct problems of the
    installation.
    """
    import jax

    import trinoc
    from trinoc.io.compile_cache import COMPILE_CACHE_VARIABLE, enable_compile_cache

    parts = {"python": f"{platform.python_version()} on {platform.platform()}"}
    parts |= {name: _version(name) or "not installed" for name in LIBRARIES}
    for extra, names in EXTRAS.items():
        missing = [name for name in names if _version(name) is None]
        parts[f"extra {extra}"] = f"pip install 'trinoc[{extra}]'" if missing else "installed"
    parts["devices"] = ", ".join(f"{d.platform} {d.device_kind}" for d in jax.devices())
    folder = enable_compile_cache()
    off = os.environ.get(COMPILE_CACHE_VARIABLE, "").lower() in ("off", "0", "no")
    parts["compile cache"] = str(folder or ("off" if off else "cannot be used"))

    remedies = [
        f"pip install {name}"
        for name in LIBRARIES
        if parts[name] == "not installed" and name not in OPENCV
    ]
    wheels = [name for name in OPENCV if _version(name) is not None]
    if len(wheels) > 1:
        remedies.append(
            f"{len(wheels)} wheels bring cv2: pip uninstall -y {' '.join(wheels)} && pip install "
            "opencv-python-headless"
        )
    if folder is None and not off:
        remedies.append(f"set {COMPILE_CACHE_VARIABLE} to a folder that only you can write to")
    width = max(map(len, parts))
    lines = [f"{name:<{width}}  {text}" for name, text in parts.items()]
    return "\n".join([f"trinoc {trinoc.__version__}", *lines]), remedies


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
