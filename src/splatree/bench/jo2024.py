"""Figures that Jo 2024, "Identifying Unnecessary 3D Gaussians using Clustering", prints in its tables and text: theirs, from an
RTX A6000 with pre-trained models, never measured here.

The table is consistent with the text of §3.5 for two datasets; for Deep Blending the mean of the two scenes is 83.575 %, the
text says 83.56 %, and the five scenes of Fig. 2 average 66.1 %, the text says 65.7 %.
"""

from splatree.bench.experiment import Table

__all__ = ["BREAKDOWN", "DATASETS", "MEANS_IN_TEXT", "SPEED_UPS", "TABLE_I", "TABLE_II", "table", "table_ii"]

DATASETS: dict[str, tuple[str, ...]] = {
    "Tanks&Temples": ("Train", "Truck"),
    "Deep Blending": ("Playroom", "Dr. Johnson"),
    "Mip-NeRF360": ("Bicycle", "Bonsai", "Counter", "Garden", "Kitchen", "Room", "Stump", "Treehill"),
}
"""Scenes of Table I by their data set."""

METHODS = ("baseline", "only distance", "distance + radius")

# PSNR (dB), SSIM and exclusion rate (%) of the three methods, in the order of METHODS.
TABLE_I: dict[str, tuple[tuple[float, float, float], ...]] = {
    "Train": ((21.77, 0.8045, 36.64), (21.45, 0.8025, 33.97), (21.77, 0.8045, 28.01)),
    "Truck": ((24.94, 0.8710, 65.46), (24.72, 0.8701, 64.11), (24.94, 0.8710, 60.45)),
    "Playroom": ((29.93, 0.9006, 86.96), (29.91, 0.9002, 86.75), (29.93, 0.9006, 83.57)),
    "Dr. Johnson": ((28.94, 0.8963, 86.46), (28.90, 0.8953, 86.31), (28.94, 0.8963, 83.58)),
    "Bicycle": ((25.17, 0.7625, 75.50), (25.10, 0.7620, 74.92), (25.17, 0.7625, 73.76)),
    "Bonsai": ((31.98, 0.9377, 67.32), (31.91, 0.9375, 66.43), (31.98, 0.9377, 63.52)),
    "Counter": ((28.89, 0.9048, 56.44), (28.76, 0.9038, 54.83), (28.89, 0.9048, 49.42)),
    "Garden": ((27.18, 0.8607, 67.46), (27.10, 0.8604, 67.07), (27.18, 0.8607, 64.31)),
    "Kitchen": ((30.71, 0.9227, 39.05), (30.51, 0.9222, 36.87), (30.71, 0.9227, 31.71)),
    "Room": ((31.34, 0.9158, 76.28), (30.70, 0.9147, 75.51), (31.34, 0.9158, 69.95)),
    "Stump": ((26.56, 0.7702, 81.09), (26.54, 0.7699, 79.94), (26.56, 0.7702, 77.25)),
    "Treehill": ((22.30, 0.6307, 77.58), (22.27, 0.6303, 76.88), (22.30, 0.6307, 74.50)),
}
"""Table I: the exclusion rate of the baseline is that of step 1 itself, the ideal."""

MEANS_IN_TEXT: dict[str, float] = {"Tanks&Temples": 44.23, "Deep Blending": 83.56, "Mip-NeRF360": 63.05}
"""Mean exclusion rate of distance + radius by data set, %, as §3.5 says it."""

BREAKDOWN: dict[str, float] = {
    "share of step 1 in a frame, %": 51.3,
    "step 1 falls by, %": 66.9,
    "unnecessary Gaussians, mean of five scenes, %": 65.7,
    "overhead of step 0 in computation, %": 6.2,
}
"""Figures of §1, §2.2 and §4.1 on the frame's time; the unit of the 6.2 % is not said."""


TABLE_II: dict[str, tuple[str, float, float]] = {
    "area": ("mm2", 9.94, 628.0),
    "frequency": ("MHz", 500.0, 1410.0),
    "DRAM bandwidth": ("GB/s", 25.6, 768.0),
    "SRAM": ("MB", 1.0, 6.0),
    "technology": ("nm", 28.0, 8.0),
    "power": ("W", 3.5, 300.0),
}
"""Table II: unit, the accelerator, the RTX A6000."""

SPEED_UPS: dict[str, float] = {
    "clustering on the GPU, mean": 1.12,
    "clustering on the accelerator, mean": 1.31,
    "accelerator over GPU, mean": 10.7,
    "accelerator over GPU, largest": 13.3,
}
"""§4.4 on Fig. 9, whose bars are printed as a picture only: Mip-NeRF 360, RTX A6000."""


def table() -> Table:
    """Table I as a table, with the efficiency: exclusion rate over that of the baseline."""
    rows = []
    for dataset, scenes in DATASETS.items():
        for scene in scenes:
            row: dict[str, object] = {"data set": dataset, "scene": scene}
            for method, (psnr, ssim, excluded) in zip(METHODS, TABLE_I[scene], strict=True):
                row |= {f"PSNR {method}": psnr, f"SSIM {method}": ssim, f"excluded % {method}": excluded}
            row["efficiency"] = TABLE_I[scene][2][2] / TABLE_I[scene][0][2]
            rows.append(row)
    notes = ("K is not said. Pictures are compared with photographs there.",)
    return Table(
        "jo2024_table_I",
        "Table I",
        rows,
        source="Jo 2024, Table I; theirs, RTX A6000, not measured here",
        notes=notes,
    )


def table_ii() -> Table:
    """Table II as a table."""
    rows = [
        {"what": what, "unit": unit, "accelerator": ours, "RTX A6000": gpu}
        for what, (unit, ours, gpu) in TABLE_II.items()
    ]
    return Table("jo2024_table_II", "Table II", rows, source="Jo 2024, Table II; theirs, not measured here")
