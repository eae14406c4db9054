"""``splatree info``: what a scene holds."""

import json
import math
import shlex
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from splatree.cli.advice import Outliers, doubts_of, outliers_of
from splatree.cli.console import Console, counted, size, table
from splatree.cli.files import Reading, check_inputs, read_options
from splatree.cli.histogram import Histogram, in_lines, linear, logarithmic
from splatree.io.estimate import estimated_bytes
from splatree.io.formats.splatree.format import is_compact
from splatree.io.notes import origin_in_words, sentences_in
from splatree.io.outline import Outline, read_outline
from splatree.io.registry import stored_bytes
from splatree.render.framing.survey import survey_of
from splatree.render.framing.upright import direction_in_words, guess_up
from splatree.render.paths import bounds_of
from splatree.scene.levels import LevelRecord
from splatree.scene.origin import NO_ORIGIN, STEPS_PER_SIGMA, Origin, coarsest_step
from splatree.scene.scene import Scene, Source


@dataclass(frozen=True)
class Command:
    """Say what a scene holds: counts, levels, sizes, where it lies, which way is up, how it is drawn, who made it.

    Histograms show opacity, size and extent. Outliers come with the command that drops them, other formats with an estimate of
    the size that the scene would have in them.
    """

    paths: Positional[tuple[Path, ...]]
    """Files or folders; several are read as one scene."""
    level: int | None = None
    """Level of detail to read from a format that has several; 0 is the finest."""
    reading: Annotated[Reading, arg(name="", help="")] = Reading()
    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class Info:
    """What is in a scene."""

    paths: tuple[str, ...]
    """Files or folders read."""
    format: str
    """Name of the format."""
    compact: bool
    """Whether it is a compact .splatree, whose values are rounded."""
    num_gaussians: int
    """Gaussians that were not made by merging: the leaves."""
    num_nodes: int
    """All rows, merged nodes included."""
    num_sampled: int
    """Gaussians that everything beside counts, levels and sizes is taken of: all, or of a folder of parts 250,000 at most."""
    levels: int
    """Largest depth + 1."""
    nodes_per_depth: tuple[int, ...]
    """Nodes at each depth, roots first."""
    record: LevelRecord | None
    """How the levels were made and are to be drawn; None without levels."""
    clusters: dict[str, float] | None
    """Number of clusters, rows of one and radius (median); None without clusters."""
    sh_degree: int
    """Degree of the spherical harmonics."""
    mode: str
    """How it is meant to be drawn."""
    threshold: float
    """τ: opacity below which a splat ends."""
    tile_rule: str
    """Rule for the tiles of a splat."""
    file_bytes: int
    """Size of the files that were named, and of those that a meta.json or lod-meta.json names, of every level."""
    bytes: int
    """Memory of the columns."""
    box_min: tuple[float, ...]
    """Least coordinates of the centres, world units."""
    box_max: tuple[float, ...]
    """Largest coordinates of the centres, world units."""
    centre: tuple[float, ...]
    """Median of the centres, weighted by opacity."""
    origin: Origin
    """Where the zero of the scene lies: what its coordinates are relative to in memory."""
    coordinate_step: float
    """Distance of neighbouring float32 numbers at the scene's coordinates, world units."""
    radius: float
    """Distance from there that holds 90 % of the opacity, world units."""
    opacity: dict[str, float]
    """Quantiles of the leaves' opacities."""
    scale: dict[str, float]
    """Quantiles of the leaves' largest standard deviations, world units."""
    histograms: dict[str, Histogram]
    """`opacity` of the leaves; their `size`, the largest standard deviation, and their `extent`, the distance from the
    centre. Both are in world units and in bins of equal ratio."""
    up: tuple[float, ...] | None
    """Unit vector that points up, as `render` guesses it; None for an empty scene."""
    up_reason: str
    """The hint that counted most for it."""
    up_is_sure: bool
    """Whether the hints for it agree."""
    outliers: tuple[Outliers, ...]
    """Gaussians that look as if they did not belong into the scene, and what drops them."""
    doubts: tuple[str, ...]
    """What looks as if the file held other values than its format says, a sentence each."""
    estimated_bytes: dict[str, int]
    """Estimated size of the leaves in other formats, by suffix, bytes."""
    in_chunks: bool
    """Whether the file went through in chunks, without its harmonics in memory."""
    next: str
    """Command to go on with."""
    metadata: dict[str, str] = field(default_factory=dict)
    """Rules and provenance that the file carries."""


def run(command: Command) -> Info:
    """Read the scene and describe it."""
    check_inputs(command.paths)
    # Nothing is drawn here, so a file that other properties would change is described, and what is lost is said.
    reading = replace(command.reading, ignore_properties=True)
    return describe(read_outline(command.paths, read_options(reading, level=command.level)))


def describe(outline: Outline) -> Info:
    """What is in a scene."""
    scene = outline.scene
    leaves = np.flatnonzero(scene.tree.is_leaf)
    means, logits = (column[leaves] for column in (scene.gaussians.means, scene.gaussians.logit_opacities))
    with np.errstate(over="ignore"):  # exp(800) is infinite and gives 0, as it should
        opacities = 1 / (1 + np.exp(-logits.astype(np.float64)))
    sizes = np.exp(scene.gaussians.log_scales.max(axis=1, initial=-np.inf)[leaves].astype(np.float64))
    centre, radius = bounds_of(scene) if len(scene) else (np.zeros(3), 0.0)
    distances = np.linalg.norm(means - centre.astype(np.float32), axis=1)
    half_radius = float(np.median(distances)) if len(leaves) else 0.0
    upright = guess_up(survey_of(outline.sample), scene.source) if len(scene) else None
    origin = np.asarray(scene.source.origin)
    degree = outline.sample.gaussians.sh_degree
    return Info(
        paths=scene.source.paths,
        format=scene.source.format,
        compact=_is_compact(scene.source),
        num_gaussians=outline.num_leaves,
        num_nodes=outline.num_nodes,
        num_sampled=len(leaves),
        levels=len(outline.nodes_per_depth),
        nodes_per_depth=outline.nodes_per_depth,
        record=scene.tree.record,
        clusters=_clusters(scene),
        sh_degree=degree,
        mode=scene.mode,
        threshold=scene.threshold,
        tile_rule=scene.tile_rule or "ellipse",
        file_bytes=sum(stored_bytes(Path(path)) for path in scene.source.paths),
        bytes=outline.nbytes,
        box_min=_point(outline.box[0] + origin),
        box_max=_point(outline.box[1] + origin),
        centre=_point(centre + origin),
        origin=scene.source.origin,
        coordinate_step=coarsest_step(float(np.abs(centre).max())),
        radius=radius,
        opacity=_quantiles(opacities),
        scale=_quantiles(sizes),
        histograms={
            "opacity": linear(opacities, 0, 1),
            "size": logarithmic(sizes),
            "extent": logarithmic(distances),
        },
        up=None if upright is None else upright.up,
        up_reason="" if upright is None else upright.reason,
        up_is_sure=upright is not None and upright.lead > 1,
        outliers=outliers_of(scene, sizes, opacities, half_radius),
        doubts=doubts_of(scene, logits, sizes, half_radius),
        estimated_bytes=estimated_bytes(outline.num_leaves, degree),
        in_chunks=outline.in_chunks,
        next=_next(scene, has_levels=len(outline.nodes_per_depth) > 1),
        metadata=dict(scene.source.metadata),
    )


def _is_compact(source: Source) -> bool:
    files = [Path(path) for path in source.paths if source.format == "splatree" and Path(path).is_file()]
    return any(is_compact(path) for path in files)


def _next(scene: Scene, *, has_levels: bool) -> str:
    """The command that a user would want next: levels where there are none and some can be made, else a picture."""
    named = [] if "-" in scene.source.paths else scene.source.paths  # standard input cannot be read again
    paths = " ".join(shlex.quote(path) for path in named) or "INPUT"
    if has_levels or len(scene) < 2:
        return f"splatree render {paths} -o pictures"
    stem = named[0].rstrip("/").rsplit("/", 1)[-1].split(".")[0] if named else "scene"
    output = f"{stem or 'scene'}.splatree"
    if Path(output).exists():  # perhaps the scene itself
        output = f"{stem or 'scene'}_levels.splatree"
    output = shlex.quote(output)
    return f"splatree build {paths} {'-o ' if len(named) > 1 else ''}{output}"


def _point(numbers: np.ndarray) -> tuple[float, ...]:
    return tuple(float(x) for x in numbers)


def _clusters(scene: Scene) -> dict[str, float] | None:
    if scene.clusters is None:
        return None
    rows, radius = np.median(scene.clusters.counts), np.median(scene.clusters.radii)
    return {"number": len(scene.clusters), "rows": float(rows), "radius": float(radius)}


def _shortened(value: str) -> str:
    """A value of the metadata; of a list the words, in which only what would steer a terminal is escaped."""
    with suppress(ValueError):
        words = json.loads(value)
        if isinstance(words, list) and all(isinstance(word, str) for word in words):
            value = "".join(c if c.isprintable() else repr(c)[1:-1] for c in ", ".join(words))
    return value if len(value) < 200 else value[:197] + "..."


def show(info: Info) -> str:
    """The description in words."""
    digits = _digits(info)
    point = f"({{:.{digits}g}}, {{:.{digits}g}}, {{:.{digits}g}})".format
    sentences = [(key, text) for key in ("notes", "lost") for text in sentences_in(info.metadata, key)]
    rest = {key: value for key, value in info.metadata.items() if key not in ("notes", "lost")}
    rows = [
        ("read", ", ".join(info.paths) or "(in memory)"),
        ("format", f"{info.format}, compact: values are rounded" if info.compact else info.format),
        ("Gaussians", f"{info.num_gaussians:,}"),
        ("nodes", f"{info.num_nodes:,} in {counted(info.levels, 'level')}"),
        *([("statistics", f"of {info.num_sampled:,} Gaussians")] if info.num_sampled < info.num_gaussians else []),
        ("nodes per depth", " ".join(f"{n:,}" for n in info.nodes_per_depth)),
        *([("levels", _record_words(info.record))] if info.record else []),
        *([("clusters", _cluster_words(info.clusters))] if info.clusters else []),
        ("harmonics", f"degree {info.sh_degree}"),
        ("drawn", f"{info.mode}, τ = {info.threshold:.4g}, {info.tile_rule}"),
        ("file", f"{size(info.file_bytes)}, {info.file_bytes / max(1, info.num_nodes):.1f} bytes a row"),
        ("memory", f"{size(info.bytes)}"),
        ("box", f"{point(*info.box_min)} to {point(*info.box_max)}"),
        ("90 % within", f"{info.radius:.4g} of {point(*info.centre)}"),
        ("opacity", _in_words(info.opacity)),
        ("largest scale", _in_words(info.scale)),
        ("coordinates", _step_words(info)),
        *([("up", _up_words(info.up, info))] if info.up else []),
        *(("outliers", f"{o.number:,} {o.kind}: {o.advice}") for o in info.outliers),
        *(("doubtful", doubt) for doubt in info.doubts),
        *([("other formats", _formats_words(info.estimated_bytes))] if info.num_gaussians else []),
        *(({"notes": "note", "lost": "lost"}[key], text) for key, text in sentences),
        *((f"  {key}", _shortened(value)) for key, value in rest.items()),
    ]
    described = table([{"": name, " ": value} for name, value in rows]).strip("\n ")
    titles = {
        "opacity": "opacity",
        "size": "size: largest standard deviation, world units",
        "extent": "extent: distance from the centre, world units",
    }
    bars = [line for name, title in titles.items() for line in in_lines(title, info.histograms[name])]
    return "\n".join([described, *bars, *([f"next: {info.next}"] if info.num_gaussians else [])])


def _up_words(up: tuple[float, ...], info: Info) -> str:
    guess = "" if info.up_is_sure else "; this is a guess, see --up of `splatree render`"
    return f"{direction_in_words(np.array(up))}, by {info.up_reason}{guess}"


def _formats_words(estimates: dict[str, int]) -> str:
    smallest_first = sorted(estimates.items(), key=lambda item: item[1])
    return "estimated " + ", ".join(f"{suffix} {size(num)}" for suffix, num in smallest_first)


def _digits(info: Info) -> int:
    """Significant digits with which a coordinate says four of the scene's size."""
    largest = max(map(abs, (*info.box_min, *info.box_max)))
    length = max(high - low for low, high in zip(info.box_min, info.box_max, strict=True))
    return min(max(4, 4 + math.ceil(math.log10(largest / length))), 15) if 0 < length < largest else 4


def _step_words(info: Info) -> str:
    relative = "" if info.origin == NO_ORIGIN else f"relative to the origin {origin_in_words(info.origin)}; "
    words = f"{relative}float32 leaves steps of {info.coordinate_step:.2g}"
    if info.coordinate_step * STEPS_PER_SIGMA > info.scale["median"] > 0:
        words += (
            f", coarse beside the median scale {info.scale['median']:.2g}: the file was written far from zero; move it with "
            "--translate before it is rounded, in the program that made it or from a file in double precision"
        )
    return words


def _record_words(record: LevelRecord) -> str:
    sizes = f", sizes {record.steps[0]:.4g} to {record.steps[-1]:.4g}" if record.steps else ""
    return f"rule {record.rule}{sizes}; drawn by profile {record.profile}"


def _cluster_words(clusters: dict[str, float]) -> str:
    number, rows, radius = clusters["number"], clusters["rows"], clusters["radius"]
    return f"{number:,}, median of {rows:,.0f} rows and radius {radius:.3g}"


def _quantiles(values: np.ndarray) -> dict[str, float]:
    shares = {"min": 0.0, "5 %": 0.05, "median": 0.5, "95 %": 0.95, "max": 1.0}
    return {name: float(np.quantile(values, share)) if len(values) else 0.0 for name, share in shares.items()}


def _in_words(quantiles: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in quantiles.items())
