"""``splatree doctor``: what this machine can draw with, and what to do about missing parts."""

import platform
import sys
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated

import numpy as np
from tyro.conf import arg

from splatree.cli.console import Console, table
from splatree.errors import DeviceError
from splatree.kernels.cpu import _core
from splatree.kernels.cuda.compile import CACHE, find_compilers, load_compiler
from splatree.kernels.cuda.device import open_device
from splatree.kernels.cuda.library import dotted, load_driver
from splatree.metrics.psnr import psnr
from splatree.render.pipeline import render
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.version import program_version

LEAST_DB = 60.0
"""The GPU's picture of the self-test is as good as the processor's from here on: an error of 1/1000."""


@dataclass(frozen=True)
class Command:
    """Say what was found on this machine for drawing on the processor and on a GPU, draw a small picture on both, and say what to
    do about what is missing or too old."""

    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class Finding:
    """One thing that was looked for."""

    name: str
    """What."""
    found: str
    """What is there; empty if nothing."""
    problem: str = ""
    """What is wrong with it and what to do; empty if nothing is."""


@dataclass(frozen=True)
class Diagnosis:
    """Everything that was looked for."""

    cuda: bool
    """Whether scenes can be drawn with ``--device cuda``."""
    findings: tuple[Finding, ...] = field(default_factory=tuple)
    """One entry a thing."""


def run(command: Command) -> Diagnosis:
    """Look for everything; nothing of it is an error."""
    findings = [
        Finding("splatree", program_version()),
        Finding("python", f"{platform.python_version()} on {platform.system()} {platform.machine()}"),
        Finding("processor", f"{_core.hardware_threads()} threads, instruction set {_core.isa()}"),
        _driver(),
        _compiler(),
        _gpu(),
        _torch(),
    ]
    needed = [finding for finding in findings if finding.name in ("GPU driver", "NVRTC", "GPU")]
    if not any(finding.problem for finding in needed):
        findings.append(_self_test())
        needed.append(findings[-1])
    return Diagnosis(not any(finding.problem for finding in needed), tuple(findings))


def show(diagnosis: Diagnosis) -> str:
    """The findings as a table, and what to do."""
    rows = [{"": finding.name, "found": finding.found or "nothing"} for finding in diagnosis.findings]
    lines = [table(rows), ""]
    problems = [finding for finding in diagnosis.findings if finding.problem]
    lines += [f"{finding.name}: {finding.problem}" for finding in problems]
    lines.append("scenes can be drawn with --device cuda" if diagnosis.cuda else "scenes are drawn on the processor")
    return "\n".join(lines)


def _driver() -> Finding:
    try:
        driver = load_driver()
    except DeviceError as error:
        return Finding("GPU driver", "", str(error))
    return Finding("GPU driver", f"supports CUDA {dotted(driver.version())}")


def _compiler() -> Finding:
    try:
        wanted = load_driver().version()
    except DeviceError:
        wanted = None
    try:
        compiler = load_compiler(wanted)
    except DeviceError as error:
        return Finding("NVRTC", ", ".join(find_compilers()) if wanted else "", str(error))
    number = ".".join(map(str, compiler.version))
    kept = sum(1 for _ in CACHE.expanduser().glob("*.cubin"))
    return Finding("NVRTC", f"{number} in {compiler.path}; {kept} compiled files in {CACHE}")


def _gpu() -> Finding:
    try:
        device = open_device(0)
    except DeviceError as error:
        return Finding("GPU", "", str(error))
    memory = f"{device.memory_bytes / 2**30:.0f} GiB"
    return Finding(
        "GPU", f"{device.name}, {device.architecture}, {device.num_multiprocessors} multiprocessors, {memory}"
    )


def _torch() -> Finding:
    try:
        found = version("torch")
    except PackageNotFoundError:
        return Finding("torch", "not installed; pictures on a GPU can be had as its tensors if it is")
    loaded = " (loaded)" if "torch" in sys.modules else ""
    return Finding("torch", found + loaded)


def _self_test() -> Finding:
    """A small scene on both devices."""
    rng = np.random.default_rng(0)
    shapes = {
        "means": (200, 3),
        "quats": (200, 4),
        "log_scales": (200, 3),
        "logit_opacities": (200,),
        "sh": (200, 4, 3),
    }
    columns = {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}
    columns["log_scales"] -= 3
    scene, camera = (
        Scene.flat(Gaussians(**columns)),
        Camera.look_at(np.array([0, 0, -4.0]), np.zeros(3), width=64, height=48),
    )
    try:
        agreement = psnr(render(scene, camera, device="cuda").image, render(scene, camera).image)
    except DeviceError as error:
        return Finding("self-test", "", str(error))
    if agreement < LEAST_DB:
        problem = (
            f"found {agreement:.0f} dB between the two devices' pictures, wanted {LEAST_DB:.0f}; please report this"
        )
        return Finding("self-test", f"{agreement:.0f} dB", problem)
    return Finding("self-test", f"the GPU's picture agrees with the processor's to {agreement:.0f} dB")
