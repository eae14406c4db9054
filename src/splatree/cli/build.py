"""``splatree build``: the levels of detail of a scene, and its clusters."""

import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import arg

from splatree.cli.calibrate import TrainingViews, Views, in_words, training_views, views_in_words
from splatree.cli.comparison import Reporting, read_back
from splatree.cli.comparison import in_words as comparison_in_words
from splatree.cli.console import Console, UsageError, counted, size, table
from splatree.cli.files import (
    Files,
    in_mode,
    inputs_and_output,
    lost_and_noted,
    read_options,
    read_scene,
    repairs_of,
    told,
)
from splatree.cli.folders import in_words as folder_in_words
from splatree.cli.folders import run_through_files
from splatree.cli.radius_check import CHECKED_FAST, are_usual, warnings_of
from splatree.cli.runs import Run, goes_on, interruptions
from splatree.clusters.build import ClusterOptions, build_clusters
from splatree.io.estimate import estimated_compact_bytes
from splatree.io.formats.streamed_sog.format import mode_of_levels
from splatree.io.options import WriteOptions
from splatree.io.photos import PhotosUsed
from splatree.io.reading import read_levels
from splatree.io.registry import stored_bytes
from splatree.io.writing import write
from splatree.lod.build import leaves_of
from splatree.lod.link import link_levels
from splatree.lod.options import BuildOptions
from splatree.lod.report import report_levels
from splatree.outofcore.build import BuiltFolder
from splatree.outofcore.clustering import ClusteredFile, cluster_file
from splatree.outofcore.needs import needs_of
from splatree.outofcore.options import FolderOptions
from splatree.render.build import build_lod
from splatree.render.calibrate import calibrate
from splatree.render.calibration import CalibrateOptions, Calibration, calibrated
from splatree.render.compare_page import Comparison
from splatree.render.trial import SAMPLE, middle_of
from splatree.scene.modes import check_mode_of_levels
from splatree.scene.names import Mode
from splatree.scene.scene import Scene
from splatree.scene.trial import MethodTrial
from splatree.train.checkpoint import remove
from splatree.train.options import RunFiles
from splatree.train.refine import Refined, refine
from splatree.train.refine_options import RefineOptions

WORTH_A_WORD_BYTES = 1 << 16
"""Of smaller files nobody asks why they are larger than the input: heads and names are then a part of it, too."""

GROWTH_WORTH_A_WORD = 1.1
"""Smaller ones nobody notices."""

STEPS = {"radii": "radius", "pixel_sizes": "pixel"}
"""What each level was made by, in the record of the levels and in the table."""


@dataclass(frozen=True)
class Command:
    """Build levels of detail, clusters or both, and write one file: in.ply out.splatree, or chunk_*/ -o city.splatree.

    A scene larger than memory is built through files: --max-memory 4G writes a folder of parts. Its levels by a radius are those
    of a build in memory; those by pairs are chosen cell by cell. With --flat --clusters one file is written, that of memory. A
    build that would take more than half of the free memory does so by itself, and says so.
    """

    files: Annotated[Files, arg(name="", help="")]
    levels: Literal["grow", "file"] = "grow"
    """`grow`: merge the Gaussians, by the options below; `file`: link the levels of the input, a streamed SOG."""
    mode: Mode | None = None
    """How the scene was trained and will be drawn; merged nodes depend on it. None: as the file says, else `classic`."""
    fast: bool = False
    """Levels by a radius, and no measurements: neither which method suits the scene, nor what is hidden."""
    compact: bool = False
    """Write a compact .splatree: values are rounded, and it is hardly larger than a .sog of the scene."""
    clusters: int | Literal["auto"] | None = None
    """Number of clusters, which views then leave out whole; `auto`: one for 128 rows, 1,024 to 32,768. None: no clusters."""
    flat: bool = False
    """Make no levels: only clusters, of the Gaussians as they are; a scene that has levels keeps them."""
    refine: float | None = None
    """Let the merged nodes learn from pictures of the leaves for so many minutes of processor time, as `splatree refine` does."""
    going_on: Annotated[Run, arg(name="", help="")] = Run()
    options: Annotated[BuildOptions, arg(name="", help="")] = BuildOptions()
    running: Annotated[FolderOptions, arg(name="", help="")] = FolderOptions()
    clustering: Annotated[ClusterOptions, arg(name="", help="")] = ClusterOptions()
    views: Annotated[Views, arg(name="", help="")] = Views()
    calibration: Annotated[CalibrateOptions, arg(name="", help="")] = CalibrateOptions()
    reporting: Annotated[Reporting, arg(name="", help="")] = Reporting()
    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class Built:
    """What was written."""

    output: Path
    """The file."""
    num_gaussians: int
    """Leaves."""
    num_nodes: int
    """Leaves and merged nodes."""
    levels: int
    """Largest depth + 1."""
    num_roots: int
    """Nodes without a parent."""
    nodes_per_depth: tuple[int, ...]
    """Nodes at each depth, roots first."""
    children: dict[str, int]
    """How many merged nodes have 2, 3, ... children."""
    rules: dict[str, Any] | None
    """Radii, and nodes left after each level, and the rules, as they are written into the file; None without levels."""
    clusters: dict[str, Any] | None
    """Number and rules of the clusters, as they are written into the file; None without clusters."""
    bytes: int
    """Size of the file."""
    input_bytes: int
    """Size of the files that were read; 0 for what was fetched from elsewhere."""
    growth: str | None
    """How much larger the file is than the input, and which form is more compact; None if it is not larger."""
    repairs: dict[str, int]
    """How many values or rows each rule of repair touched."""
    lost: tuple[str, ...]
    """What the file does not hold, a sentence each."""
    trial: MethodTrial | None = None
    """How both methods of building did on a sample; None: the method was named, or the scene is too small to tell."""
    calibration: Calibration | None = None
    """The τ that was chosen, if views were given."""
    photographs: PhotosUsed | None = None
    """Which photographs it was chosen with; None if none were given."""
    notes: tuple[str, ...] = ()
    """What the readers of the scene and of the cameras did that the user should know, a sentence each."""
    comparison: Comparison | None = None
    """What a cut of the levels loses in pictures, if --report asks for it."""


def run(command: Command) -> Built | BuiltFolder | ClusteredFile:
    """Read, build, write."""
    if command.refine is None and command.going_on != Run():
        raise UsageError(
            "found --run or --resume without --refine, which alone can go on; wanted --refine MINUTES, too"
        )
    if command.going_on.resume:
        command = replace(command, files=replace(command.files, force=True))
    through_files = command.running != FolderOptions()
    only_clusters = command.flat and command.clusters is not None
    if through_files:
        _check_through_files(command, only_clusters=only_clusters)
        if not only_clusters:
            return run_through_files(command.files, command.options, command.running, command.mode)
    inputs, output = inputs_and_output(command.files, keeps_tree=True, options=WriteOptions(compact=command.compact))
    _check_levels(command)
    command.reporting.check(force=command.files.force)
    views = training_views(command.views)
    if through_files:
        return _clustered(command, inputs, output)
    needs = needs_of(inputs, read_options(command.files.reading))
    if needs is None or not needs.are_large:
        return _in_memory(command, inputs, output, views)
    if needing := [*_needing_memory(command), *([output.suffix] if output.suffix != ".splatree" else [])]:
        short = f"{needs}, and it cannot go through files with {', '.join(needing)}"
        return _in_memory(command, inputs, output, views, short)
    if only_clusters:
        made = _clustered(command, inputs, output)
        return replace(made, notes=(f"{needs}: the clusters were made through files", *made.notes))
    built = run_through_files(command.files, command.options, command.running, command.mode)
    return replace(built, notes=(f"{needs}: a folder was built, through files", *built.notes))


def _check_through_files(command: Command, *, only_clusters: bool) -> None:
    """Refuse what a build through files cannot do."""
    if needing := _needing_memory(command):
        then = (
            "; clusters of levels are added afterwards: splatree build FOLDER out.splatree --flat --clusters auto"
            if "--clusters" in needing
            else ""
        )
        raise UsageError(
            f"found --max-memory, --workers, --scheduler or the size of parts with {', '.join(needing)}, which need the "
            f"scene in memory; wanted one of them{then}"
        )
    if only_clusters and command.running != FolderOptions(max_memory=command.running.max_memory):
        raise UsageError(
            "found --workers, --scheduler or the size of parts with --flat: clusters are made by one process, and not in "
            "parts; wanted --max-memory alone"
        )


def _check_levels(command: Command) -> None:
    """Refuse options that contradict each other or the levels that are asked for."""
    if isinstance(command.clusters, int) and command.clusters < 1:
        raise UsageError(f"clusters: found {command.clusters}, wanted 1 or more, or auto")
    if command.flat and command.clusters is None:
        raise UsageError("found --flat without --clusters, which leaves nothing to build; wanted --clusters auto too")
    if command.flat and command.refine is not None:
        raise UsageError("found --flat and --refine, but without levels nothing can learn; wanted one of them")
    _learning(command)  # refuses minutes out of range
    if command.flat and command.levels == "file":
        raise UsageError("found --flat and --levels file, which contradict each other; wanted one of them")
    if command.fast and (command.flat or command.levels == "file" or command.options.method == "pairs"):
        raise UsageError(
            "found --fast with --flat, --levels file or --method pairs, but it makes levels by a radius; wanted one of them"
        )
    if (command.flat or command.levels == "file") and (changed := _changed(command.options)):
        raise UsageError(
            f"found {'--flat' if command.flat else '--levels file'} and {', '.join(changed)}, which only levels that grow use; "
            "wanted one of them"
        )


def _in_memory(
    command: Command, inputs: Sequence[Path], output: Path, views: TrainingViews | None, short: str | None = None
) -> Built:
    """Read, build and write in memory; ``short`` says that there may be too little of it."""
    folder = None if command.refine is None else command.going_on.folder(output, "refine", force=command.files.force)
    scene, warned = _with_levels(command, inputs)
    refined = None if folder is None else _refined(command, scene, folder)
    scene = scene if refined is None else refined.scene
    if command.clusters is not None:
        scene = build_clusters(scene, command.clusters, command.clustering)
    calibration = None
    if views is not None:
        views = views.relative_to(scene)
        calibration = calibrate(scene, views.cameras, command.calibration, photos=views.photos)
        scene = calibrated(scene, calibration, held_out=views.rule)
    force = command.files.force
    written = write(scene, output, force=force, options=WriteOptions(compact=command.compact))
    learned = () if folder is None or refined is None else _learned(refined, folder)
    lost, notes = lost_and_noted(scene, written)
    report = report_levels(scene)
    num_bytes, input_bytes = stored_bytes(output), sum(stored_bytes(Path(path)) for path in scene.source.paths)
    return Built(
        output=output,
        num_gaussians=report.num_leaves,
        num_nodes=report.num_nodes,
        levels=len(report.nodes_per_depth),
        num_roots=report.num_roots,
        nodes_per_depth=report.nodes_per_depth,
        children={str(count): number for count, number in report.fan_out.items()},
        rules=_metadata(scene, "levels"),
        clusters=_metadata(scene, "clusters"),
        bytes=num_bytes,
        input_bytes=input_bytes,
        growth=_growth(scene, output, num_bytes, input_bytes),
        repairs=repairs_of(scene),
        lost=lost,
        trial=None if scene.tree.record is None else scene.tree.record.trial,
        calibration=calibration,
        photographs=None if views is None else views.used,
        notes=(*([] if short is None else [short]), *notes, *warned, *learned, *([] if views is None else views.notes)),
        # The leaves of what is read back are the input, bit for bit.
        comparison=read_back(output, scene, command.reporting, made_from=", ".join(map(str, inputs)), force=force),
    )


def _clustered(command: Command, inputs: Sequence[Path], output: Path) -> ClusteredFile:
    """Clusters alone, made through files."""
    if output.suffix != ".splatree":
        raise UsageError(f"{output}: found --max-memory and a format that is not written in parts, wanted .splatree")
    assert command.clusters is not None
    return cluster_file(
        *(inputs, output, command.clusters, command.clustering),
        reading=read_options(command.files.reading),
        mode=command.mode,
        max_memory=command.running.max_memory,
        force=command.files.force,
    )


def _needing_memory(command: Command) -> list[str]:
    """What is asked for that needs the scene in memory."""
    asked = {
        "--flat": command.flat and command.clusters is None,
        "--levels file": command.levels == "file",
        "--clusters": command.clusters is not None and not command.flat,
        "--compact": command.compact,
        "--refine": command.refine is not None,
        "views": (command.views, command.calibration) != (Views(), CalibrateOptions()),
        "--report": command.reporting != Reporting(),
    }
    return [name for name, is_asked in asked.items() if is_asked]


def _growth(scene: Scene, output: Path, num_bytes: int, input_bytes: int) -> str | None:
    """How much larger the file is than what was read, and the form that is more compact, if there is one."""
    if not 0 < input_bytes * GROWTH_WORTH_A_WORD < num_bytes or num_bytes < WORTH_A_WORD_BYTES:
        return None
    larger = f"{num_bytes / input_bytes:.1f} times the {size(input_bytes)} of the input, {size(num_bytes - input_bytes)} more"
    estimate = estimated_compact_bytes(scene.tree.num_leaves, len(scene), scene.gaussians.sh_degree)
    if 2 * estimate >= num_bytes or output.suffix.lower() == ".rad":
        return larger
    smaller = shlex.quote(str(output.with_name(f"{output.stem}_compact.splatree")))
    return (
        f"{larger}: a {output.suffix} keeps every value as it is; a compact .splatree rounds them and takes about "
        f"{size(estimate)} (estimated): splatree convert {shlex.quote(str(output))} {smaller} --compact"
    )


def _changed(options: BuildOptions) -> list[str]:
    """Names of the options that are not what they are by default."""
    usual = BuildOptions()
    return [name for name, value in vars(options).items() if value != getattr(usual, name)]


def _with_levels(command: Command, inputs: Sequence[Path]) -> tuple[Scene, tuple[str, ...]]:
    """The scene that is read, with levels unless none are wanted, and what the user should know of them."""
    if command.levels == "file":
        return _linked(command, inputs), ()
    scene = read_scene(inputs, command.files.reading)
    if command.flat:
        return in_mode(scene, command.mode), ()
    if command.mode is not None:  # levels that are there are made anew
        scene = replace(scene, mode=command.mode)
    options = replace(command.options, method="radius", visibility=False) if command.fast else command.options
    built = build_lod(scene, options)
    if not are_usual(options):
        return built, ()
    return built, warnings_of(middle_of(leaves_of(scene), CHECKED_FAST if command.fast else SAMPLE))


def _linked(command: Command, inputs: Sequence[Path]) -> Scene:
    if len(inputs) != 1:
        raise UsageError(f"--levels file: found {len(inputs)} inputs, wanted one, a folder with lod-meta.json")
    levels = read_levels(inputs[0], repair=command.files.reading.repair)
    if command.mode is not None:
        check_mode_of_levels(command.mode, mode_of_levels(inputs[0]))
        levels = tuple(replace(scene, mode=command.mode) for scene in levels)
    return link_levels(levels)


def _learning(command: Command) -> RefineOptions:
    return RefineOptions() if command.refine is None else RefineOptions(minutes=command.refine)


def _refined(command: Command, scene: Scene, folder: Path) -> Refined:
    """The scene, whose merged nodes have learned."""
    with interruptions() as interrupted:
        return refine(scene, _learning(command), files=RunFiles(folder, command.going_on.resume), stop=interrupted)


def _learned(refined: Refined, folder: Path) -> tuple[str, ...]:
    """What merged nodes learned, a sentence each, once the scene is written: a run that has ended is removed then."""
    learned = (
        f"merged nodes learned for {refined.cpu_seconds:.0f} s: {refined.before.mean():.2f} to "
        f"{refined.after.mean():.2f} dB in views kept to judge by"
    )
    if not refined.stopped:
        remove(folder)
    return (learned, *refined.notes, *([goes_on(folder)] if refined.stopped else []))


def _metadata(scene: Scene, key: str) -> dict[str, Any] | None:
    return json.loads(scene.source.metadata[key]) if key in scene.source.metadata else None


def show(built: Built | BuiltFolder | ClusteredFile) -> str:
    """The result in words."""
    if isinstance(built, ClusteredFile):
        wrote = (
            f"wrote {built.path}: {counted(built.num_gaussians, 'Gaussian')}, {counted(built.num_rows, 'node')}, "
            f"{counted(built.num_clusters, 'cluster')}, {size(built.bytes)}"
        )
        return "\n".join([wrote, *told(built.repairs, built.lost, built.notes)])
    levels = _levels_in_words(built.rules)
    if isinstance(built, BuiltFolder):
        return f"{levels}{folder_in_words(built)}"
    clusters = f"{counted(built.clusters['clusters'], 'cluster')}, " if built.clusters else ""
    wrote = (
        f"{levels}wrote {built.output}: {counted(built.num_gaussians, 'Gaussian')}, {counted(built.num_nodes, 'node')} "
        f"({built.num_nodes / max(1, built.num_gaussians):.2f} ×), {counted(built.levels, 'level')}, "
        f"{counted(built.num_roots, 'root')}, {clusters}"
        f"{size(built.bytes)}"
    )
    growth = [] if built.growth is None else [built.growth]
    calibration = [] if built.calibration is None else [in_words(built.calibration)]
    views = views_in_words(built.photographs, built.notes)
    compared = [] if built.comparison is None else comparison_in_words(built.comparison)
    tried = [] if built.trial is None else [f"levels by {_chosen(built)}: {built.trial.in_words()}"]
    return "\n".join([wrote, *growth, *tried, *views, *calibration, *told(built.repairs, built.lost), *compared])


def _chosen(built: Built) -> str:
    return "pairs" if built.rules is not None and built.rules["rule"] == "pairs" else "a radius"


def _levels_in_words(rules: dict[str, Any] | None) -> str:
    """A table of the levels."""
    if rules is None:
        return ""
    nodes = rules["nodes"][1:]
    kind, sizes = next(
        ((kind, rules[key]) for key, kind in STEPS.items() if key in rules), ("made", ["linked"] * len(nodes))
    )
    shown = [(f"{size:.4g}" if isinstance(size, float) else size, n) for size, n in zip(sizes, nodes, strict=True)]
    rows = [{"level": i + 1, kind: size, "nodes left": n} for i, (size, n) in enumerate(shown)]
    return f"{table(rows)}\n" if rows else ""
