"""Golden comparison: every output of the package on fixed inputs, frozen and compared again.

    python benchmarks/golden.py freeze FILE.npz [--only PART ...]
    python benchmarks/golden.py compare FILE.npz [--only PART ...] [--tolerance 1e-12] [--sigmas S]

Freeze before a change that must not move a number, compare after it. The inputs are the demo's
pictures, made scenes and pictures of fixed seeds and, where the environment names them by
TRINOC_DATA=DIR, the shared scenes and the photographs of Merton College. Of each output that
differs two figures are printed: the largest difference relative to the largest entry of its array,
and, where its covariance was frozen beside it, the largest difference in claimed sigmas. With
--sigmas these outputs may differ by as much, which is how a change of solver is judged. Names,
statuses, sentences and NaN must be equal; of texts the first line that differs is printed.
Compare on the machine that froze: another one rounds otherwise. Exits 1 where something differs.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from golden_parts import PARTS
from golden_parts.records import array_of

import trinoc

# Estimates, and the covariance of the same answer: of all its numbers, or of each row's.
COVARIANCE_OF = {
    "values": "covariance",
    "lines_mm": "covariance_mm2",
    "points_mm": "covariance_mm2",
    "vertices_mm": "vertices_covariance_mm2",
    "endpoints_px": "covariance_px2",
    "centres_px": "covariance_px2",
    "uv_px": "covariance_px2",
    "fragments_px": "fragments_covariance_px2",
}


class Difference(NamedTuple):
    """Difference of an output from its frozen value.

    Fields
    ------
    relative : largest change over the largest entry; infinity for another shape, word or NaN.
    sigmas : largest change over its claimed sigma; NaN where none was frozen.
    description : the difference of texts and shapes.
    """

    relative: float
    sigmas: float = float("nan")
    description: str = ""

    def within(self, tolerance: float, sigmas: float | None) -> bool:
        """True if the difference is tolerable: by its sigmas if both sigmas are given."""
        if sigmas is not None and np.isfinite(self.sigmas):
            return self.sigmas <= sigmas
        return self.relative <= tolerance


def outputs(only: list[str]) -> dict[str, np.ndarray]:
    """Every output by name."""
    values = {}
    for name in only or PARTS:
        began = time.process_time()
        values |= {f"{name}.{key}": array_of(value) for key, value in PARTS[name]()}
        print(f"{name}: {time.process_time() - began:.1f} s of processor time", flush=True)
    return values


def difference(
    now: np.ndarray, before: np.ndarray, covariance: np.ndarray | None = None
) -> Difference:
    """Difference of an output from the frozen one; `covariance` is that of the frozen one."""
    if now.shape != before.shape:
        return Difference(float("inf"), description=_first_apart(now, before))
    if now.dtype.kind not in "fiub" or before.dtype.kind not in "fiub":
        if np.array_equal(now, before):
            return Difference(0.0)
        return Difference(float("inf"), description=_first_apart(now, before))
    now, before = now.astype(np.float64), before.astype(np.float64)
    is_finite = np.isfinite(before)
    if not np.array_equal(now[~is_finite], before[~is_finite], equal_nan=True):
        return Difference(float("inf"), description="other entries are NaN or infinite")
    if not is_finite.any() or np.array_equal(now[is_finite], before[is_finite]):
        return Difference(0.0, 0.0)
    change = np.abs(now - before)
    largest = np.abs(before[is_finite]).max()
    relative = float(change[is_finite].max() / largest) if largest > 0 else float("inf")
    return Difference(relative, _in_sigmas(change, covariance))


def _in_sigmas(change: np.ndarray, covariance: np.ndarray | None) -> float:
    if covariance is None or covariance.dtype.kind != "f" or covariance.ndim < 2:
        return float("nan")
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    if variance.size != change.size:
        return float("nan")
    change = change.reshape(variance.shape)
    usable = np.isfinite(change) & np.isfinite(variance) & (variance > 0)
    return (
        float((change[usable] / np.sqrt(variance[usable])).max()) if usable.any() else float("nan")
    )


def _first_apart(now: np.ndarray, before: np.ndarray) -> str:
    """First lines that differ if both are texts, else both shapes."""
    if now.dtype.kind not in "US" or before.dtype.kind not in "US":
        return f"shape {before.shape} -> {now.shape}"
    old, new = ("\n".join(array.ravel().tolist()).split("\n") for array in (before, now))
    old += [""] * (len(new) - len(old))
    new += [""] * (len(old) - len(new))
    first = next((pair for pair in zip(old, new, strict=True) if pair[0] != pair[1]), ("", ""))
    return f"\n    before: {first[0][:300]}\n    now:    {first[1][:300]}"


def compared(now: dict[str, np.ndarray], frozen: dict[str, np.ndarray]) -> dict[str, Difference]:
    """Differences of every output that both have."""
    differences = {}
    for name in sorted(now.keys() & frozen.keys()):
        prefix, _, last = name.rpartition(".")
        covariance = frozen.get(f"{prefix}.{COVARIANCE_OF.get(last, '')}")
        differences[name] = difference(now[name], frozen[name], covariance)
    return differences


def report(differences: dict[str, Difference], tolerance: float, sigmas: float | None) -> int:
    """Print outputs beyond the tolerance, then the largest differences of each part. Returns the
    number of outputs beyond the tolerance."""
    worse = {
        name: entry for name, entry in differences.items() if not entry.within(tolerance, sigmas)
    }
    print(f"{'beyond the tolerance':60s} relative  sigmas")
    for name, entry in worse.items():
        print(f"{name:60s} {entry.relative:8.2g} {entry.sigmas:7.2g} {entry.description}")
    print(f"\n{'part':20s} outputs  equal  beyond  relative  sigmas")
    for part in dict.fromkeys(name.split(".")[0] for name in differences):
        outputs = {name: entry for name, entry in differences.items() if name.split(".")[0] == part}
        beyond = sum(name in worse for name in outputs)
        equal = sum(entry.relative == 0 for entry in outputs.values())
        finite = [entry.relative for entry in outputs.values() if np.isfinite(entry.relative)]
        by_sigma = [entry.sigmas for entry in outputs.values() if np.isfinite(entry.sigmas)]
        print(
            f"{part:20s} {len(outputs):7d} {equal:6d} {beyond:7d}  {max(finite, default=0.0):8.2g} "
            f"{max(by_sigma, default=0.0):7.2g}"
        )
    return len(worse)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("verb", choices=("freeze", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--only", nargs="*", default=[], choices=PARTS)
    parser.add_argument("--tolerance", type=float, default=1e-12)
    parser.add_argument("--sigmas", type=float, help="allowed where a covariance is known")
    options = parser.parse_args()
    trinoc.io.enable_compile_cache()
    print(f"trinoc of {Path(trinoc.__file__).parent.parent}", flush=True)
    now = outputs(options.only)
    if options.verb == "freeze":
        np.savez_compressed(options.file, **now)
        print(f"{len(now)} outputs frozen in {options.file}")
        return 0
    with np.load(options.file) as file:
        names = [k for k in file.files if not options.only or k.split(".")[0] in options.only]
        frozen = {name: file[name] for name in names}
    beyond = report(compared(now, frozen), options.tolerance, options.sigmas)
    missing = sorted(now.keys() ^ frozen.keys())
    for name in missing:
        print(f"{name:60s} only {'now' if name in now else 'before'}")
    return 1 if beyond or missing else 0


if __name__ == "__main__":
    sys.exit(main())
