"""Two examples a verb, and the options that its help shows first."""

__all__ = ["BASIC", "EXAMPLES"]

EXAMPLES: dict[str, tuple[str, ...]] = {
    "demo": ("splatree demo", "splatree demo --output folder/"),
    "info": ("splatree info city.ply", "splatree info chunk_*/ --json"),
    "check": ("splatree check city.splatree", "splatree check chunk_*/ --json"),
    "train": (
        "splatree train PHOTOGRAPHS -o scene.splatree --minutes 10",
        "splatree train PHOTOGRAPHS -o scene.splatree --levels pairs --max-gaussians 500000 --minutes 60",
    ),
    "convert": (
        "splatree convert city.ply city.sog",
        "splatree convert city.ply turned.spz --rotate -90 0 0 --min-opacity 2%",
    ),
    "thin": (
        "splatree thin city.ply small.ply --keep 25%",
        "splatree thin city.ply small.sog --count 500000 --report lost/",
    ),
    "build": ("splatree build city.ply city.splatree", "splatree build chunk_*/ -o city.splatree --clusters auto"),
    "refine": (
        "splatree refine city.splatree better.splatree",
        "splatree refine room.splatree better.splatree --cameras cameras.json --minutes 5",
    ),
    "calibrate": (
        "splatree calibrate city.splatree --data photographs/",
        "splatree calibrate city.splatree faster.splatree --loss-db 0.5",
    ),
    "render": ("splatree render city.ply", "splatree render city.ply --turntable city.mp4 --width 1280 --height 720"),
    "view": ("splatree view city.splatree", "splatree view city.ply --cameras cameras.json"),
    "stream": ("splatree stream city.splatree web/", "splatree stream city.ply web/ --force"),
    "serve": ("splatree serve web/", "splatree serve web/ --port 8080"),
    "eval": (
        "splatree eval small.sog --reference city.ply --report lost/",
        "splatree eval city.splatree --data photographs/",
    ),
    "simulate": ("splatree simulate city.splatree", "splatree simulate city.splatree --cameras cameras.json --json"),
    "bench table1": (
        "splatree bench table1",
        "splatree bench table1 --scene city.splatree --cameras cameras.json -o results/",
    ),
    "bench table2": (
        "splatree bench table2",
        "splatree bench table2 --scene city.splatree --data photographs/ -o results/",
    ),
    "bench table3": (
        "splatree bench table3",
        "splatree bench table3 --scene city.splatree --data photographs/ -o results/",
    ),
    "bench fig5": ("splatree bench fig5", "splatree bench fig5 --scene city.splatree --frames 100 -o results/"),
    "bench fig6": ("splatree bench fig6", "splatree bench fig6 --scene city.splatree --frames 100 -o results/"),
    "bench fig7": ("splatree bench fig7", "splatree bench fig7 --scene city.splatree --frames 100 -o results/"),
    "bench clusters": ("splatree bench clusters", "splatree bench clusters --scene city.splatree -o results/"),
    "bench cullfuzz": ("splatree bench cullfuzz", "splatree bench cullfuzz --gaussians 1000000 --seed 1"),
    "bench popping": (
        "splatree bench popping",
        "splatree bench popping --scene city.splatree --frames 60 --budget 200000",
    ),
    "bench accelerator": ("splatree bench accelerator", "splatree bench accelerator --set step1.lanes=1 -o results/"),
    "formats": ("splatree formats", "splatree formats --json"),
    "doctor": ("splatree doctor", "splatree doctor --json"),
}
"""Two lines a verb: the plainest, and one with what is most asked for."""

BASIC: dict[str, tuple[str, ...]] = {
    "clean": ("output", "floaters", "max-distance", "max-size", "min-size", "cameras", "dry-run", "repair"),
    "refine": ("output", "cameras", "minutes", "iterations", "repair"),
    "view": ("beside", "cameras", "photos", "budget", "up", "port", "host", "device", "repair"),
    "stream": ("output", "format", "report", "cameras", "levels", "zip", "chunked", "origin", "repair"),
    "convert": (
        "output", "level", "min-opacity", "scale", "rotate", "translate", "crop-box", "crop-sphere", "sh-degree",
        "report", "repair",
    ),
    "thin": ("output", "keep", "count", "radius", "max-memory", "report", "repair"),
    "build": ("output", "levels", "method", "clusters", "data", "cameras", "max-memory", "report", "repair"),
    "calibrate": ("output", "cameras", "data", "loss-db", "held-out"),
    "render": (
        "output", "turntable", "video", "cameras", "view", "eye", "target", "up", "distance", "fov-y-deg", "look", "level",
        "views", "width", "height", "background", "device", "depth", "alpha", "quality",
    ),
    "eval": (
        "reference", "report", "cameras", "data", "held-out", "every", "scale", "frames", "views", "width", "height", "device",
        "quality",
    ),
    "info": ("level", "repair"),
    "check": ("repair",),
    "train": (
        "output", "minutes", "iterations", "max-gaussians", "size", "degree", "mode", "levels", "held-out", "masks", "exposure",
        "cameras", "resume", "force",
    ),
    "simulate": ("output", "cameras", "preset", "views"),
}  # fmt: skip
"""Options that most people want, by verb; of other verbs all are."""
