"""Effect of damaged files on libraries that read them, and on trinoc's readers.

A library that ends the process reads in a child process (`trinoc/io/child_process.py`): SciPy.

    python benchmarks/library_readers.py [--files 400] [--seed 1]

Each library reads mutated copies of a valid file in child processes that may take 2 GiB and two
seconds a file. A row: files that were read, that were refused by an exception of Python, that ended
the process (a signal, or no memory), and that took longer; the longest refusal in seconds.
"""

import argparse
import multiprocessing
import os
import re
import resource
import tempfile
import time
from collections import Counter
from pathlib import Path

import cv2
import numpy as np

MOST_BYTES, LONGEST_S = 2 << 30, 2.0
# A forked child of a process with threads may hang.
SPAWN = multiprocessing.get_context("spawn")
HUGE = (b"99999999999999999999", b"-1", b"1e400", b"\xff\xff\xff\x7f", b"[" * 99, b"&a *a", b"\0")


def _mat(path: Path) -> None:
    import scipy.io

    scipy.io.loadmat(path)


def _storage(path: Path) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    root = storage.root()
    for key in root.keys():  # noqa: SIM118, no mapping
        node = root.getNode(key)
        node.mat() if node.isMap() else node.real()


def _safe_yaml(path: Path) -> None:
    import ruamel.yaml

    ruamel.yaml.YAML(typ="safe", pure=True).load(path.read_text("latin-1"))


def _obj(path: Path) -> None:
    import trimesh

    trimesh.load(path, file_type="obj", process=False)


def _pillow(path: Path) -> None:
    from PIL import Image

    _ = Image.open(path).size


def _trinoc(path: Path) -> None:
    from trinoc.io import FORMATS, load_shape, read_image

    match path.suffix:
        case ".obj":
            load_shape(path)
        case ".mat" | ".yml" | ".yaml":
            FORMATS[re.split(r"\d", path.name)[0]].load(path)
        case _:
            read_image(path)


def _valid(folder: Path) -> dict[str, Path]:
    """A valid file of each kind."""
    from tests.io.formats.bench import bench_rig
    from trinoc.io import FORMATS

    files = {}
    for name, ending in (("matlab", ".mat"), ("opencv", ".yml"), ("kalibr", ".yaml")):
        files[name] = folder / f"valid{ending}"
        FORMATS[name].save(bench_rig(4), files[name])
    files["obj"] = folder / "valid.obj"
    corners = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1))
    files["obj"].write_text(corners + "f 1 2 4 3\nf 5 6 8 7\nl 1 5\nl 2 6 8\n")
    image = np.random.default_rng(1).integers(0, 256, (48, 64), np.uint8)
    for ending in ("png", "tif", "jpg", "bmp", "pgm", "webp"):
        files[ending] = folder / f"valid.{ending}"
        files[ending].write_bytes(cv2.imencode(f".{ending}", image)[1].tobytes())
    return files


READERS = [
    ("matlab", "scipy.io", _mat),
    ("matlab", "trinoc", _trinoc),
    ("opencv", "cv2.FileStorage", _storage),
    ("opencv", "trinoc", _trinoc),
    ("kalibr", "ruamel.yaml", _safe_yaml),
    ("kalibr", "trinoc", _trinoc),
    ("obj", "trimesh", _obj),
    ("obj", "trinoc", _trinoc),
    *((e, "Pillow", _pillow) for e in ("png", "tif", "jpg", "bmp", "pgm", "webp")),
    *((e, "trinoc", _trinoc) for e in ("png", "tif", "jpg", "bmp", "pgm", "webp")),
]


def damaged(content: bytes, random: np.random.Generator) -> bytes:
    """A copy with one to three damages: truncated, or with changed or inserted bytes."""
    for _ in range(random.integers(1, 4)):
        position = int(random.integers(0, max(len(content), 1)))
        insertion = HUGE[random.integers(len(HUGE))]
        match random.integers(5):
            case 0:
                content = content[:position]
            case 1 if content:
                content = (
                    content[:position] + bytes([random.integers(256)]) + content[position + 1 :]
                )
            case 2:
                content = content[:position] + insertion + content[position:]
            case 3:
                content = content[:position] + insertion + content[position + len(insertion) :]
            case _:
                content = (
                    content[:position] + content[position : position + 12] * 40 + content[position:]
                )
    return content


def _child(read, path: Path, names: list[str], pipe) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES + (6 << 30), MOST_BYTES + (6 << 30)))
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
    for name in names:
        pipe.send(("begin", name, 0.0))
        start = time.monotonic()
        try:
            read(path / name)
        except MemoryError:
            outcome = "no memory"
        except BaseException:
            outcome = "refused"
        else:
            outcome = "read"
        pipe.send((outcome, name, time.monotonic() - start))
    pipe.send(("end", "", 0.0))


def tried(read, path: Path, names: list[str]) -> tuple[Counter, float]:
    """Outcomes of the files, and the longest time of one."""
    count, longest, remaining = Counter(), 0.0, list(names)
    while remaining:
        receiver, sender = SPAWN.Pipe(duplex=False)
        process = SPAWN.Process(target=_child, args=(read, path, remaining, sender))
        process.start()
        sender.close()
        now = ""
        try:
            while receiver.poll(30.0 if not now else LONGEST_S + 3):
                outcome, name, seconds = receiver.recv()
                if outcome == "end":
                    remaining = []
                    break
                now = name
                if outcome != "begin":
                    count[outcome if seconds < LONGEST_S else "slow"] += 1
                    longest = max(longest, seconds)
                    remaining = remaining[remaining.index(name) + 1 :]
            else:
                count["slow"] += 1
                remaining = (
                    remaining[remaining.index(now) + 1 :] if now in remaining else remaining[1:]
                )
        except EOFError:
            count["crashed"] += 1
            remaining = remaining[remaining.index(now) + 1 :] if now in remaining else remaining[1:]
        process.kill()
        process.join()
    return count, longest


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    heads = ("file", "reader", "read", "refused", "memory", "crashed", "slow", "longest s")
    print("{:8s} {:16s} {:>6s} {:>8s} {:>7s} {:>8s} {:>5s} {:>10s}".format(*heads))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        valid = _valid(folder)
        for kind, reader, read in READERS:
            random = np.random.default_rng(options.seed)
            content, ending = valid[kind].read_bytes(), valid[kind].suffix
            names = []
            for k in range(options.files):
                names.append(f"{kind}{k}{ending}")
                (folder / names[-1]).write_bytes(damaged(content, random))
            count, longest = tried(read, folder, names)
            print(
                f"{kind:8s} {reader:16s} {count['read']:6d} {count['refused']:8d} "
                f"{count['no memory']:7d} {count['crashed']:8d} {count['slow']:5d} {longest:10.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
