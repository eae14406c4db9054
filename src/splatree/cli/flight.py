"""What the demo's flight away from a scene found: what its table, its chart and its report are made of."""

from dataclasses import dataclass
from pathlib import Path

from splatree.cli.eval_views import View
from splatree.scene.options import SelectOptions


@dataclass(frozen=True)
class DemoView(View):
    """One distance of the flight."""

    distance: float = 0.0
    """From the camera to the centre of the scene, world units (about a metre here)."""
    psnr_where_covered: float = 0.0
    """PSNR over the pixels that the scene covers: what the black around a distant scene would flatter."""
    curve: tuple[tuple[float, int, float], ...] = ()
    """Quality at other settings: τ_R, nodes drawn, PSNR against all leaves."""


@dataclass(frozen=True)
class Demo:
    """What the demo found."""

    num_gaussians: int
    """Leaves: the Gaussians of the scene as it was trained."""
    num_nodes: int
    """Leaves and merged nodes."""
    levels: int
    """Largest depth + 1."""
    nodes_per_depth: tuple[int, ...]
    """Nodes at each depth, roots first."""
    mode: str
    """How the scene is drawn."""
    select: SelectOptions
    """How the cuts were chosen."""
    seconds: dict[str, float]
    """Wall time of reading, building, and drawing and comparing all views."""
    views: tuple[DemoView, ...]
    """The flight, from near to far."""
    report: Path
    """The page with the pictures."""
    credit: str
    """Whose scene it is."""
