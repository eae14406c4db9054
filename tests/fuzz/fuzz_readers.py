"""Coverage-guided fuzzing of every reader with atheris (libFuzzer for Python); README.md says how.

One process a kind of file: seeds are small scenes written in every way that the format has, and the stored corpus. libFuzzer
changes their bytes, and `splatree.read` must give a scene that can be drawn or one of our errors, in little memory and time. What
gzip holds is changed inside and packed again, because a change of the stream never gets past its checksum; a .rad is also there
without compression.
"""

import argparse
import random
import re
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(
    0, str(ROOT)
)  # for tests.io; splatree is the installed one, whose core is compiled, or that of PYTHONPATH

SECONDS_MAX = 60
"""A file of a few kilobytes that takes longer is a hang. On a busy machine the first one is slow: it loads modules."""

STORED_BYTES = 16_000
"""Bytes of inputs that are stored of a kind."""


def prepare(kind: str, folder: Path) -> Path:
    """Write the corpus and a dictionary of words; return the file whose bytes are changed."""
    from tests.fuzz.kinds import seeds_of, stored_inputs, target_of

    seeds = seeds_of(kind, folder)
    inputs = [seed.read_bytes() for seed in seeds] + stored_inputs(kind)
    (folder / "corpus").mkdir()
    for number, data in enumerate(inputs):
        (folder / "corpus" / f"{number}").write_bytes(data)
    words = {w for data in inputs for w in re.findall(rb'"[A-Za-z_0-9]{2,24}"|[a-z_]{4,20}', data[:20000])}
    extra = [b"-1", b"1e999", b"NaN", b"null", b"4294967295", b"2147483647", b"\xff\xff\xff\x7f", b"\x00\x00\xc0\x7f"]
    tokens = "".join('"' + "".join(f"\\x{b:02x}" for b in word) + '"\n' for word in [*sorted(words)[:200], *extra])
    (folder / "words").write_text(tokens)
    return target_of(seeds, folder)


def store(kind: str, corpus: Path) -> None:
    """Keep what a run added to its corpus, smallest first: each input reached branches that those before it did not."""
    from tests.fuzz.kinds import CORPUS, stored_inputs

    found = [path.read_bytes() for path in corpus.iterdir() if not path.name.isdecimal()]
    inputs = sorted({*found, *stored_inputs(kind)}, key=lambda data: (len(data), data))
    CORPUS.mkdir(exist_ok=True)
    left = STORED_BYTES
    with zipfile.ZipFile(CORPUS / f"{kind}.zip", "w", zipfile.ZIP_DEFLATED) as stored:
        for number, data in enumerate(inputs):
            left -= len(data)
            if left < 0:
                break
            stored.writestr(zipfile.ZipInfo(f"{number:03}"), data, zipfile.ZIP_DEFLATED)  # with a fixed date


def fuzz(target: Path, folder: Path, arguments: list[str]) -> None:
    """Fuzz in this process until libFuzzer ends it. Nothing of splatree may run before: its code would count as seen."""
    import importlib
    import pkgutil

    import atheris

    with atheris.instrument_imports(include=["splatree.io", "splatree.maths"]):
        import splatree.io.formats

        # Readers are loaded when they are first called, which would be after this block.
        for module in pkgutil.walk_packages(splatree.io.formats.__path__, "splatree.io.formats."):
            importlib.import_module(module.name)
    from tests.fuzz.reading import read_once, through_compression, with_odd_number

    def mutate(data: bytes, max_size: int, seed: int) -> bytes:
        numbers = random.Random(seed)
        if numbers.random() < 0.5:
            return through_compression(data, lambda raw: with_odd_number(raw, numbers))[:max_size]
        return through_compression(data, lambda raw: atheris.Mutate(raw, len(raw) + 64))[:max_size]

    options = [f"-timeout={SECONDS_MAX}", "-rss_limit_mb=4096", f"-dict={folder / 'words'}", "-print_final_stats=1"]
    options += ["-max_len=16384", *arguments, str(folder / "corpus")]
    atheris.Setup([sys.argv[0], *options], lambda data: read_once(target, data), custom_mutator=mutate)
    atheris.Fuzz()


def main() -> None:
    """Fuzz kinds one after the other, each in a process of its own, and say what was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", nargs="*", default=[], help="formats to fuzz; default: all")
    parser.add_argument("--seconds", type=int, default=90, help="time for each")
    parser.add_argument("--findings", type=Path, default=Path("fuzz-findings"), help="where failing files are kept")
    parser.add_argument("--store", action="store_true", help="store what reaches new branches in tests/fuzz/corpus")
    parser.add_argument("--target", type=Path, help=argparse.SUPPRESS)
    known, arguments = parser.parse_known_args()
    if known.target:
        fuzz(known.target, Path(arguments[0]), arguments[1:])
        return
    from tests.fuzz.kinds import all_kinds

    known.findings.mkdir(exist_ok=True)
    total = 0
    for kind in known.kinds or all_kinds():
        with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:
            command = [sys.executable, __file__, "--target", str(prepare(kind, Path(folder))), folder]
            command += [f"-max_total_time={known.seconds}", f"-artifact_prefix={known.findings.resolve()}/{kind}-"]
            start = time.monotonic()
            done = subprocess.run(command, capture_output=True, text=True, errors="replace")
            if known.store:
                store(kind, Path(folder) / "corpus")
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
