"""Good files of every format with random damage, read one after the other: `python -m tests.formats.mutation FIRST LAST`.

File k is the same on every machine. What it prints is a line for each file that raised anything but our own error, or took more
than 5 s of the processor's time, and at the end how many were read and the largest memory [MB].
"""

from __future__ import annotations

import gzip
import re
import signal
import sys
import tempfile
import traceback
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from robocar.core import RobocarError
from tests.formats.hostile import MODELS, READERS, world
from tests.formats.test_other_images import FILES

SECONDS = 5


def _text(path: str) -> bytes:
    return (MODELS / path).read_bytes()


def _npz() -> bytes:
    import io

    file = io.BytesIO()
    np.savez_compressed(file, world_0=np.ones((3, 3)), world_1=np.ones((2, 3)))
    return file.getvalue()


_WORLD = world(("1 2 0", "0.075"), ("2 3 0", "0.1")).encode()
_FLASER = b"".join(b"FLASER 3 1.0 2.0 8.0 %d 0 0 %d 0 0 %d h %d\n" % (k, k, k, k) for k in range(9))
_ROBOTLASER = b"ROBOTLASER1 0 -1.57 3.14 0.1 30 0.01 0 2 1 2 0 0 0 0 0 0 0 0 0 0.2 0.2 1 5 h 5\n" * 3
SEEDS: Mapping[str, tuple[bytes, tuple[str, ...]]] = {
    "a.yaml": (_text("scenarios/office.yaml"), ("scenario", "config.yaml of a run")),
    "movers.yaml": (_text("scenarios/thesis-field.yaml"), ("scenario",)),
    "suite.yaml": (_text("suites/quick.yaml"), ("suite",)),
    "ros.yaml": (
        b"image: b.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n",
        ("check",),
    ),
    "robot.yaml": (_text("robots/robocar/robot.yaml"), ("robot.yaml",)),
    "calibration.yaml": (_text("robots/robocar/calibration.yaml"), ("calibration.yaml",)),
    "config.yaml": (
        b"settings: {a: 1}\nseed: 0\nnavigator: a-star\nscenario: {map: u, start: [0, 0, 0]}\n",
        ("config.yaml of a run",),
    ),
    "baseline.json": (_text("suites/quick.baseline.json")[:3000] + b"}}", ("results",)),
    "metrics.json": (b'{"schema": 1, "seed": 1, "metrics": {"a": {"value": 1.5, "unit": "m"}}}', ("metrics.json of a run",)),
    "a.npz": (_npz(), ("check", "barn cylinders", "barn grids", "barn paths")),
    "a.world": (_WORLD, ("check",)),
    "a.world.gz": (gzip.compress(_WORLD, mtime=0), ("check",)),
    "a.map": (b"type octile\nheight 2\nwidth 3\nmap\n.@T\nGSW\n", ("check",)),
    "a.scen": (b"version 1\n0\ta.map\t3\t2\t0\t0\t1\t1\t1.41\n", ("check",)),
    "a.txt": (b"#####\n#S.G#\n#####\n", ("check",)),
    "a.pgm": (b"P5\n# c\n3 2\n255\n\0\xfe\xfe\xcd\xfe\0", ("check_file",)),
    "plain.pgm": (b"P2 3 2 255 0 254 254 205 254 0", ("check_file",)),
    "a.tum": (b"# time\n0 1 2 0 0 0 0 1\n1 1 2 0 0 0 0 1\n", ("check",)),
    "a.log": (_FLASER, ("check", "log")),
    "a.clf.gz": (gzip.compress(_FLASER + _ROBOTLASER, mtime=0), ("check",)),
    "b.log": (_ROBOTLASER, ("log",)),
    "a.gfs": (b"NEFF 3\nLASER_READING 2 1 2 0 0 0 1.5\n" * 3, ("log",)),
    "a.csv": (b"angle,range\n0.1,2.5\n0.2,inf\n", ("check",)),
    "index.csv": (
        b"world,n_cylinders,path_points,runpy_path_length_m,optimal_time_s_at_2mps,maximin_clearance_m\n0,3,5,1.5,2,0.3\n",
        ("barn index",),
    ),
    "Barcodes.dat": (b"1 5\n6 72\n", ("Barcodes.dat",)),
    "Odometry.dat": (b"# t v w\n0 0.1 0\n1 0.1 0.5\n", ("Robot1_Odometry.dat",)),
    **{f"image_{name}": (content, ("check_file",)) for name, content in FILES.items()},
}
"""A good file of each format, and its readers."""

_PIECES = (*(b"1e999", b"-1", b"nan", b"inf", b"9" * 50), *(bytes([c]) for c in b"[]{}<>:&*\0\xff\n "))


def mutated(k: int) -> tuple[str, bytes, tuple[str, ...]]:
    """Name, content and readers of file k."""
    rng = np.random.default_rng([0x0F11E, k])
    name, (content, readers) = list(SEEDS.items())[k % len(SEEDS)]
    data = bytearray(content)
    for _ in range(rng.integers(1, 9)):
        at, end = sorted(rng.integers(0, len(data) + 1, 2).tolist()) if data else (0, 0)
        kind = rng.integers(0, 6)
        if kind == 0 and data:
            data[min(at, len(data) - 1)] = rng.integers(0, 256)
        elif kind == 1:
            del data[at : min(end, at + 8)]
        elif kind == 2:
            data[at:at] = _PIECES[rng.integers(0, len(_PIECES))]
        elif kind == 3:
            data[at:at] = data[at : min(end, at + 40)] * int(rng.integers(1, 200))
        elif kind == 4:
            del data[end:]
        elif data:  # a number's digit, where damage goes deepest
            digits = [i for i, c in enumerate(data) if 48 <= c < 58]
            if digits:
                i = digits[rng.integers(0, len(digits))]
                data[i : i + 1] = b"%d" % rng.integers(0, 10 ** int(rng.integers(1, 12)))
    return name, bytes(data[: 1 << 20]), readers


def say(line: str) -> None:
    sys.stdout.write(line + "\n")


class Hang(BaseException):
    """A file took too long."""


def _hang(*_: object) -> None:
    raise Hang


def main(first: int, last: int) -> None:
    signal.signal(signal.SIGPROF, _hang)  # the processor's time of this process: a machine may be busy with others
    signal.signal(signal.SIGALRM, _hang)  # for what waits
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "b.pgm").write_bytes(SEEDS["a.pgm"][0])
        for k in range(first, last):
            name, content, readers = mutated(k)
            path = Path(folder) / name
            path.write_bytes(content)
            for reader in readers:
                signal.setitimer(signal.ITIMER_PROF, SECONDS)
                signal.alarm(60)
                try:
                    READERS[reader](path)
                except RobocarError as error:
                    if len(str(error)) > 4100 or not str(error).isprintable():
                        say(f"{k} {name} {reader}: a message of {len(str(error))} characters")
                except Hang:
                    say(f"{k} {name} {reader}: more than {SECONDS} s")
                except Exception:
                    say(f"{k} {name} {reader}: {traceback.format_exc()}")
                finally:
                    signal.setitimer(signal.ITIMER_PROF, 0)
                    signal.alarm(0)
    most = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text()) if sys.platform == "linux" else None
    megabytes = int(most[1]) // 1024 if most else 0  # the resource module would give the parent's, where it was larger
    say(f"read {last - first} {megabytes}")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
