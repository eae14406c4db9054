"""Every kernel compiles for every architecture within its budget of registers and shared memory, without a spill.

Needs NVRTC (extra `cuda`), no GPU. `python -m tests.kernels.test_cuda_compile` in the repository's root writes the budgets
anew, when a kernel is meant to take more.
"""

import json
import multiprocessing
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from splatree.errors import DeviceError
from splatree.kernels.cuda import compile as cuda_compile
from splatree.kernels.cuda.compile import Compiler, load_compiler
from splatree.kernels.cuda.job import fields_of, pack_numbers
from splatree.kernels.cuda.sources import STAGES, headers, kernels_of, source
from splatree.scene.options import SelectOptions
from splatree.scene.view import View

from ..scenes import camera

ARCHITECTURES = (75, 80, 86, 89, 90, 100, 120)
EACH_TIME = (75, 120)
"""The oldest and the newest; an architecture takes seven seconds, so the others are left to the slow tests."""
BUDGETS = Path(__file__).with_name("cuda_budgets.json")
Use = dict[str, dict[str, int]]


@pytest.fixture(scope="module")
def compiler() -> Compiler:
    try:
        return load_compiler()
    except DeviceError as error:
        pytest.skip(str(error))


def used_by(log: str) -> Use:
    """Registers, bytes of shared memory and of spills of each kernel, from the assembler's report."""
    parts = re.split(r"Compiling entry function '(\w+)'", log)[1:]
    return {name: dict(_numbers(text)) for name, text in zip(parts[::2], parts[1::2], strict=True)}


def _numbers(text: str) -> Iterator[tuple[str, int]]:
    for name, pattern in (("registers", r"Used (\d+) registers"), ("shared_bytes", r"(\d+) bytes smem")):
        found = re.search(pattern, text)
        yield name, int(found[1]) if found else 0
    yield "spill_bytes", sum(map(int, re.findall(r"(\d+) bytes spill", text)))
    yield "stack_bytes", sum(map(int, re.findall(r"(\d+) bytes stack frame", text)))


def measure(compiler: Compiler, architecture: int) -> Use:
    """What each kernel takes on an architecture."""

    def compiled(stage: str) -> str:
        return compiler.compile(stage, f"sm_{architecture}", "--ptxas-options=-v").log

    with ThreadPoolExecutor(2) as pool:
        return {kernel: use for log in pool.map(compiled, STAGES) for kernel, use in used_by(log).items()}


@pytest.mark.parametrize(
    "architecture", [pytest.param(a, marks=() if a in EACH_TIME else pytest.mark.slow) for a in ARCHITECTURES]
)
def test_kernels_keep_their_budgets_on_every_architecture(compiler: Compiler, architecture: int) -> None:
    budgets: Use = json.loads(BUDGETS.read_text())
    assert set(budgets) == {kernel for stage in STAGES for kernel in kernels_of(stage)}
    use = measure(compiler, architecture)
    for kernel, budget in budgets.items():
        # Versions of the compiler differ by a few registers; they are handed out in steps of 8 a thread.
        over = {k: v for k, v in use[kernel].items() if v > budget[k] + (8 if k == "registers" else 0)}
        assert not over, f"{kernel}: found {over}, wanted at most {budget}"


def test_structs_are_laid_out_as_the_runtime_packs_them(compiler: Compiler, monkeypatch: pytest.MonkeyPatch) -> None:
    numbers = pack_numbers(View(camera()), SelectOptions(), degree=0)
    jobs = {("cuda/job.h", "FrameJob"): len(numbers), ("cuda/kmeans.h", "KmeansJob"): 0}
    jobs |= {("cuda/loss.h", "LossJob"): 0, ("cuda/optimise.h", "StepJob"): 0}
    lines = [
        '#include "cuda/device.h"',
        *(f'#include "{header}"' for header, _ in jobs),
        "using namespace splatree;",
        f"static_assert(sizeof(FrameNumbers) == {len(numbers)});",
    ]
    for (header, struct), begin in jobs.items():
        arrays, sizes = fields_of(header, struct)
        fields = [*(name for name, _ in arrays), *sizes]
        lines += [f"static_assert(__builtin_offsetof({struct}, {f}) == {begin + 8 * i});" for i, f in enumerate(fields)]
        lines.append(f"static_assert(sizeof({struct}) == {begin + 8 * len(fields)});")
    monkeypatch.setattr(cuda_compile, "source", lambda stage: "\n".join(lines))
    compiler.compile("project", "sm_90")


def test_sources_are_read_whatever_the_locale() -> None:
    """NVRTC 12.4 sets the locale to C when it is loaded, and the sources have letters beyond ASCII."""
    code = "from splatree.kernels.cuda.sources import *; headers(); [source(stage) for stage in STAGES]"
    environment = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)


def test_no_lambda_is_generic() -> None:
    """NVRTC 13.0 takes such a lambda for a function of the host, and refuses it."""
    for text in (*headers().values(), *map(source, STAGES)):
        assert not re.search(r"\]\(auto\b|\]\([^)]*, auto\b", text)


def test_compiled_code_is_kept_and_what_is_damaged_is_compiled_anew(compiler: Compiler, tmp_path: Path) -> None:
    first = compiler.cubin_of("project", "sm_90", 13000, cache=tmp_path)
    (kept,) = tmp_path.iterdir()
    assert first.startswith(b"\x7fELF")
    for damage in (b"", kept.read_bytes()[:-1], b"x" * 100):
        kept.write_bytes(damage)
        assert compiler.cubin_of("project", "sm_90", 13000, cache=tmp_path) == first
        assert [p.name for p in tmp_path.iterdir()] == [kept.name]
    compiler.cubin_of("project", "sm_90", 12080, cache=tmp_path)  # another driver: another file
    compiler.cubin_of("project", "sm_80", 13000, cache=tmp_path)
    assert len(list(tmp_path.iterdir())) == 3


def test_a_cache_that_cannot_be_written_costs_only_time(compiler: Compiler, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    cubin = compiler.cubin_of("project", "sm_90", 13000, cache=tmp_path / "file" / "folder")
    assert cubin.startswith(b"\x7fELF")


def _compile_into(folder: Path) -> bytes:
    return load_compiler().cubin_of("project", "sm_90", 13000, cache=folder)


def test_processes_that_compile_at_once_do_not_disturb_each_other(compiler: Compiler, tmp_path: Path) -> None:
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        cubins = pool.map(_compile_into, [tmp_path] * 4)
    assert len(set(cubins)) == 1
    assert len(list(tmp_path.iterdir())) == 1


def test_an_error_in_device_code_shows_the_compilers_message(
    compiler: Compiler, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cuda_compile, "source", lambda stage: "__global__ void k() { nothing; }")
    with pytest.raises(
        DeviceError, match=r'project.cu does not compile for sm_90:[^"]*identifier "nothing" is undefined'
    ):
        compiler.compile("project", "sm_90")


def test_a_compiler_newer_than_the_driver_is_refused(compiler: Compiler) -> None:
    with pytest.raises(DeviceError, match=r"as the driver supports CUDA 10: update the driver"):
        load_compiler(10020)


def test_without_nvrtc_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_compile, "find_compilers", lambda: iter(()))
    with pytest.raises(DeviceError, match=r"no NVRTC.*pip install 'splatree\[cuda\]'"):
        load_compiler(13000)


def write_budgets() -> None:
    """The most that a kernel takes on any architecture, registers rounded up to the next step of 8."""
    budgets: Use = {}
    for architecture in ARCHITECTURES:
        for kernel, numbers in measure(load_compiler(), architecture).items():
            most = budgets.setdefault(kernel, dict.fromkeys(numbers, 0))
            for name, value in numbers.items():
                most[name] = max(most[name], -(-value // 8) * 8 if name == "registers" else value)
    BUDGETS.write_text(json.dumps(dict(sorted(budgets.items())), indent=1) + "\n")


if __name__ == "__main__":
    write_budgets()
