"""Coverage-guided fuzzing of every reader with atheris (libFuzzer for Python); README.md says how.

One process a kind of file: seeds are small scenes written in every way that the format has, libFuzzer changes their bytes, and
`splatree.read` must give a scene that can be drawn or one of our errors, in little memory and time. What gzip holds is changed
inside and packed again, because a change of the stream never gets past its checksum; a .rad is also there without compression.
"""

import argparse
import gzip
import json
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(
    0, str(ROOT)
)  # for tests.io; splatree is the installed one, whose core is compiled, or that of PYTHONPATH

SECONDS_MAX = 10
"""A file of a few kilobytes that takes longer is a hang."""

MEMORY_ALWAYS = 64 << 20
"""Bytes that any read may take: tables of pictures alone are 3 MB, a million Gaussians without harmonics 56 MB …"""

MEMORY_PER_BYTE = 600
"""… and for each byte of the file: flat pictures and deflate hold up to 16 and 4 Gaussians of 236 bytes in a byte or four."""


def seeds_of(kind: str, folder: Path) -> list[Path]:
    """Small files of a kind; those of a folder format are its meta.json, beside the pictures."""
    from tests.io.sog_files import bundle, write_sog
    from tests.scenes import random_gaussians

    import splatree
    from splatree import Scene, WriteOptions
    from splatree.io.registry import formats

    if kind in ("sog-folder-1", "sog-folder-2"):
        write_sog(folder / "scene", n=9, version=int(kind[-1]))
        return [folder / "scene" / "meta.json"]
    if kind == "streamed-sog":
        write_sog(folder / "scene" / "0_0", n=9)
        box = {"min": [-1, -1, -1], "max": [1, 1, 1]}
        node = {"bound": box, "lods": {"0": {"file": 0, "offset": 0, "count": 9}}}
        tree = {"bound": box, "children": [node, {**node, "lods": {"0": {"file": 0, "offset": 2, "count": 4}}}]}
        meta = {"version": 1, "count": 13, "counts": [13], "lodLevels": 1, "filenames": ["0_0/meta.json"], "tree": tree}
        (folder / "scene" / "lod-meta.json").write_text(json.dumps(meta))
        return [folder / "scene" / "lod-meta.json"]

    (chosen,) = (f for f in formats() if f.name == kind)
    flat = Scene.flat(random_gaussians(9, 1))
    tree = splatree.build_lod(Scene.flat(random_gaussians(6, 2)), splatree.BuildOptions(max_roots=2))
    paths = []
    for number, scene in enumerate((flat, tree)):
        counted = [name for name in ("compression", "format_version", "sh_bits") if name in chosen.options]
        for field, value in [("", None), *((name, v) for name in counted for v in range(9))]:
            path = folder / f"{number}{field}{value}{chosen.suffixes[0]}"
            try:
                splatree.write(scene, path, options=WriteOptions(**{field: value} if field else {}))
                paths.append(path)
            except splatree.SplatreeError:
                pass  # a value that the option does not have
    if kind == "sog":
        write_sog(folder / "scene", n=9)
        bundle(folder / "scene", folder / "b.sog")
        paths.append(folder / "b.sog")
    if kind == "ply":
        paths += [_ascii_ply(folder / "ascii.ply"), _ascii_ply(folder / "big.ply", big_endian=True)]
    if kind == "rad":
        paths.append(_plain_rad(folder / "plain.rad"))
    return paths


def _ascii_ply(path: Path, *, big_endian: bool = False) -> Path:
    names = ["x", "y", "z", *(f"f_dc_{i}" for i in range(3)), "opacity"]
    names += [*(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    kind = "binary_big_endian" if big_endian else "ascii"
    lines = [
        "ply",
        f"format {kind} 1.0",
        "element vertex 3",
        *(f"property double {n}" for n in names),
        "end_header",
        "",
    ]
    rows = np.random.default_rng(0).standard_normal((3, len(names)))
    body = rows.astype(">f8").tobytes() if big_endian else "\n".join(" ".join(map(str, row)) for row in rows).encode()
    path.write_bytes("\n".join(lines).encode() + body + b"\n" * (not big_endian))
    return path


def _plain_rad(path: Path) -> Path:
    """Without compression, with a palette and a tree."""
    from tests.io.rad_files import chunk, write_rad

    def zeros(name: str, encoding: str, size: int, **entry: float) -> tuple[dict, bytes]:
        return ({"property": name, "encoding": encoding, **entry}, bytes(size))

    properties = [
        zeros("center", "f16_lebytes", 18),
        zeros("alpha", "r8", 3, min=0, max=2),
        zeros("rgb", "r8_delta", 9, min=0, max=1),
        zeros("scales", "ln_0r8", 9, min=-9, max=1),
        zeros("orientation", "oct88r8", 9),
        zeros("sh1_code", "s8_delta", 18, min=-1, max=1),
        zeros("sh_label", "u16", 6),
        ({"property": "child_count", "encoding": "u16"}, np.array([2, 0, 0], "<u2").tobytes()),
        ({"property": "child_start", "encoding": "u32"}, np.array([1, 0, 0], "<u4").tobytes()),
    ]
    data = chunk(properties, count=3, compress=False)
    return write_rad(path, [data], count=3, maxSh=1, lodTree=True, shCodeCount=2)


def prepare(kind: str, folder: Path) -> Path:
    """Write the corpus and a dictionary of words; return the file whose bytes are changed."""
    seeds = seeds_of(kind, folder)
    (folder / "corpus").mkdir()
    for number, seed in enumerate(seeds):
        shutil.copy(seed, folder / "corpus" / f"{number}")
    words = {w for s in seeds for w in re.findall(rb'"[A-Za-z_0-9]{2,24}"|[a-z_]{4,20}', s.read_bytes()[:20000])}
    extra = [b"-1", b"1e999", b"NaN", b"null", b"4294967295", b"2147483647", b"\xff\xff\xff\x7f", b"\x00\x00\xc0\x7f"]
    tokens = "".join('"' + "".join(f"\\x{b:02x}" for b in word) + '"\n' for word in [*sorted(words)[:200], *extra])
    (folder / "words").write_text(tokens)
    return seeds[0] if seeds[0].suffix == ".json" else folder / f"changed{seeds[0].name[seeds[0].name.index('.') :]}"


def fuzz(target: Path, folder: Path, arguments: list[str]) -> None:
    """Fuzz in this process until libFuzzer ends it. Nothing of splatree may run before: its code would count as seen."""
    import atheris

    with atheris.instrument_imports(include=["splatree.io", "splatree.maths"]):
        from splatree import SplatreeError, read
    from splatree.io.check import checked

    def read_once(data: bytes) -> None:
        target.write_bytes(data)
        is_measured = zlib.crc32(data) % 4 == 0  # it takes as long as two readings
        if is_measured:
            tracemalloc.start()
        try:
            scene = read(target.parent if target.suffix == ".json" else target, repair=len(data) % 3 == 0)
        except SplatreeError as error:
            assert str(error), "an error without words"
        else:
            checked(scene, "accepted", repair=False)
            assert np.isfinite(scene.tree.extents).all(), "extents"
        finally:
            peak = tracemalloc.get_traced_memory()[1] if is_measured else 0
            tracemalloc.stop()
        assert peak <= MEMORY_ALWAYS + MEMORY_PER_BYTE * len(data), f"{peak} bytes of memory for a file of {len(data)}"

    def mutate(data: bytes, max_size: int, seed: int) -> bytes:
        numbers = random.Random(seed)
        if numbers.random() < 0.5:
            return _through_compression(data, lambda raw: _with_odd_number(raw, numbers))[:max_size]
        return _through_compression(data, lambda raw: atheris.Mutate(raw, len(raw) + 64))[:max_size]

    options = [f"-timeout={SECONDS_MAX}", "-rss_limit_mb=4096", f"-dict={folder / 'words'}", "-print_final_stats=1"]
    options += ["-max_len=16384", *arguments, str(folder / "corpus")]
    atheris.Setup([sys.argv[0], *options], read_once, custom_mutator=mutate)
    atheris.Fuzz()


def _with_odd_number(data: bytes, numbers: random.Random) -> bytes:
    """Put a number at which code goes wrong where a byte other than 0 stands: headers are mostly zeros, counts are not."""
    places = [i for i, byte in enumerate(data[:16384]) if byte] or [0]
    width = numbers.choice((1, 2, 4, 8))
    at = numbers.choice(places) // width * width
    odd = (0, 1, 2, 255, -1, -2, 2**31 - 1, 2**31, 2**15, 2**24, 2**53, numbers.getrandbits(64))
    value = (numbers.choice(odd) & (2 ** (8 * width) - 1)).to_bytes(width, "little")
    if width >= 4 and numbers.random() < 0.3:
        value = np.array(numbers.choice((np.nan, np.inf, -np.inf, 1e38, -1.0, 1e-40)), "<f4").tobytes()
    return data[:at] + value + data[at + len(value) :]


def _through_compression(data: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """Change the content of a gzip file; of other files the bytes."""
    if data[:2] == b"\x1f\x8b":
        try:
            return gzip.compress(change(gzip.decompress(data)), 1)
        except (OSError, EOFError, zlib.error):
            return change(data)
    return change(data)


KINDS = ("sog-folder-1", "sog-folder-2")
"""Kinds of file beside the formats of the registry."""


def main() -> None:
    """Fuzz kinds one after the other, each in a process of its own, and say what was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", nargs="*", default=[], help="formats to fuzz; default: all")
    parser.add_argument("--seconds", type=int, default=90, help="time for each")
    parser.add_argument("--findings", type=Path, default=Path("fuzz-findings"), help="where failing files are kept")
    parser.add_argument("--target", type=Path, help=argparse.SUPPRESS)
    known, arguments = parser.parse_known_args()
    if known.target:
        fuzz(known.target, Path(arguments[0]), arguments[1:])
        return
    from splatree.io.registry import formats

    known.findings.mkdir(exist_ok=True)
    total = 0
    for kind in known.kinds or [*(f.name for f in formats()), *KINDS]:
        with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:
            command = [sys.executable, __file__, "--target", str(prepare(kind, Path(folder))), folder]
            command += [f"-max_total_time={known.seconds}", f"-artifact_prefix={known.findings.resolve()}/{kind}-"]
            start = time.monotonic()
            done = subprocess.run(command, capture_output=True, text=True, errors="replace")
        executions = re.findall(r"number_of_executed_units:\s*(\d+)", done.stderr) or ["0"]
        coverage = re.findall(r"cov: (\d+)", done.stderr) or ["0"]
        total += int(executions[-1])
        verdict = "no findings" if done.returncode == 0 else f"FOUND (exit {done.returncode})"
        seconds = time.monotonic() - start
        print(
            f"{kind:16} {int(executions[-1]):9,} executions, {coverage[-1]:>5} edges, {seconds:4.0f} s: {verdict}",
            flush=True,
        )
        if done.returncode:
            (known.findings / f"{kind}.log").write_text(done.stdout + done.stderr)
            print("\n".join((done.stdout + done.stderr).splitlines()[-25:]), flush=True)
    print(f"{total:,} executions in all")


if __name__ == "__main__":
    main()
