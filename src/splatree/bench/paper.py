"""Figures that Wang 2026, "FilterGS", prints in its §4: theirs, on other scenes, an RTX 4090 and at 1080p; never measured here.

They stand beside our tables so that the shape of a result can be compared (who is faster, and by what factor), not its size.
Of what the paper prints, Table 2 and Table 3 mark their rows by ticks; here the ticks are words.
"""

from splatree.bench.experiment import Curve, Row, Table

__all__ = ["FIG5", "FIG7", "SOURCE", "TABLE1", "TABLE2", "TABLE3", "fig6_curves"]

SOURCE = "FilterGS (Wang 2026), {}; theirs, RTX 4090, 1080p, not measured here"

_TABLE1_SCENES = ("Block Small", "Sci-Art", "Residence (Urban)", "College", "Residence (GauU)", "Modern-Building")
# PSNR, SSIM, LPIPS, t_f, FPS for each scene; 3DGS has no filter and no t_f.
_TABLE1: dict[str, tuple[tuple[float | None, ...], ...]] = {
    "3DGS": (
        (25.42, 0.743, 0.446, None, 58.0),
        (22.35, 0.717, 0.311, None, 61.0),
        (21.92, 0.767, 0.298, None, 62.0),
        (24.21, 0.697, 0.341, None, 58.0),
        (24.15, 0.746, 0.250, None, 42.0),
        (25.79, 0.733, 0.324, None, 54.0),
    ),
    "H3DGS": (
        (25.73, 0.756, 0.440, 5.51, 83.0),
        (22.41, 0.719, 0.312, 53.46, 72.0),
        (21.99, 0.769, 0.294, 7.12, 38.0),
        (24.79, 0.713, 0.330, 5.43, 82.0),
        (24.76, 0.751, 0.236, 9.14, 61.0),
        (25.93, 0.748, 0.391, 7.26, 89.0),
    ),
    "LoG": (
        (26.52, 0.770, 0.414, 10.46, 77.0),
        (23.27, 0.737, 0.305, 11.6, 67.0),
        (22.7, 0.812, 0.267, 11.33, 66.0),
        (25.9, 0.757, 0.282, 11.97, 72.0),
        (25.09, 0.781, 0.223, 14.19, 57.0),
        (27.35, 0.814, 0.270, 8.51, 81.0),
    ),
    "OctreeGS": (
        (26.43, 0.771, 0.417, 5.13, 125.0),
        (23.81, 0.758, 0.295, 6.78, 83.0),
        (22.31, 0.793, 0.279, 5.58, 91.0),
        (25.62, 0.746, 0.287, 6.04, 104.0),
        (25.37, 0.787, 0.218, 7.59, 78.0),
        (26.56, 0.792, 0.284, 5.59, 120.0),
    ),
    "FLoD": (
        (25.06, 0.732, 0.461, 3.04, 245.0),
        (22.46, 0.721, 0.310, 6.31, 147.0),
        (21.57, 0.761, 0.305, 4.02, 174.0),
        (25.28, 0.701, 0.329, 3.79, 183.0),
        (24.2, 0.743, 0.252, 5.11, 137.0),
        (26.02, 0.742, 0.311, 2.13, 203.0),
    ),
    "FilterGS": (
        (26.31, 0.763, 0.433, 1.14, 372.0),
        (23.07, 0.749, 0.308, 1.01, 234.0),
        (22.13, 0.786, 0.283, 0.93, 297.0),
        (25.69, 0.748, 0.288, 1.05, 290.0),
        (25.31, 0.789, 0.219, 1.81, 212.0),
        (27.04, 0.810, 0.273, 1.04, 354.0),
    ),
}

TABLE1 = Table(
    "table1_paper",
    "Table 1 of the paper: methods, each trained by its own pipeline, against photographs",
    [
        {"scene": scene, "method": method}
        | dict(zip(("PSNR", "SSIM", "LPIPS", "t_f ms", "FPS"), _TABLE1[method][i], strict=True))
        for i, scene in enumerate(_TABLE1_SCENES)
        for method in _TABLE1
    ],
    SOURCE.format("Table 1"),
)

TABLE2 = Table(
    "table2_paper",
    "Table 2 of the paper: where a frame's time goes, ms, on Residence (UrbanScene)",
    [
        {"shrinking": shrink, "filter": chosen}
        | dict(zip(("T_calcu", "T_synch", "T_prepr", "T_sort", "T_alpha", "T_total", "FPS"), values, strict=True))
        for shrink, chosen, values in (
            ("no", "serial", (3.59, 7.72, 0.20, 1.04, 2.58, 15.13, 66)),
            ("yes", "serial", (3.59, 7.80, 0.27, 0.61, 1.69, 13.96, 72)),
            ("no", "parallel", (0.52, 0.41, 0.19, 1.01, 2.64, 4.77, 210)),
            ("yes", "parallel", (0.52, 0.40, 0.26, 0.57, 1.62, 3.37, 297)),
        )
    ],
    SOURCE.format("Table 2"),
    notes=("FPS is 1000 / T_total.",),
)

TABLE3 = Table(
    "table3_paper",
    "Table 3 of the paper: quality and pairs (millions) with each part switched on alone",
    [
        {"scene": scene, "shrinking": shrink, "filter": chosen, "PSNR": psnr, "SSIM": ssim, "N_P (M)": pairs}
        for scene, shrink, psnr, ssim, pairs in (
            ("College", "no", 25.90, 0.752, 3.25),
            ("College", "yes", 25.69, 0.748, 1.56),
            ("Modern-Building", "no", 27.35, 0.813, 2.13),
            ("Modern-Building", "yes", 27.04, 0.810, 1.12),
        )
        for chosen in ("serial", "parallel")
    ],
    SOURCE.format("Table 3"),
)

FIG5 = Table(
    "fig5_paper",
    "Table of Figure 5 of the paper: ways to shrink, without and with levels of detail",
    [
        {"scene": scene, "method": method, "shrinking": shrink, "PSNR": psnr, "FPS": fps, "N_P (M)": pairs}
        for scene, method, shrink, psnr, fps, pairs in (
            ("College", "3DGS", "3σ", 24.21, 58, 7.99),
            ("College", "3DGS", "τ = 1/255", 24.21, 61, 7.98),
            ("College", "3DGS", "λ_G = 0.2", 24.07, 72, 6.20),
            ("College", "FilterGS", "3σ", 25.90, 241, 3.25),
            ("College", "FilterGS", "τ = 1/255", 25.90, 246, 3.24),
            ("College", "FilterGS", "λ_G = 0.2", 25.69, 290, 1.56),
            ("Modern", "3DGS", "3σ", 25.79, 64, 5.82),
            ("Modern", "3DGS", "τ = 1/255", 25.79, 66, 5.81),
            ("Modern", "3DGS", "λ_G = 0.2", 25.67, 80, 4.31),
            ("Modern", "FilterGS", "3σ", 27.35, 302, 2.13),
            ("Modern", "FilterGS", "τ = 1/255", 27.35, 307, 2.12),
            ("Modern", "FilterGS", "λ_G = 0.2", 27.04, 354, 1.12),
        )
    ],
    SOURCE.format("Figure 5"),
)

# N_low pruned %, λ_G, N_P (M), PSNR, FPS.
_FIG7: dict[str, tuple[tuple[float, float | None, float, float, int], ...]] = {
    "Block Small": (
        (0, None, 2.53, 26.52, 311),
        (10, 0.02, 2.24, 26.52, 320),
        (20, 0.03, 1.94, 26.51, 329),
        (30, 0.05, 1.69, 26.50, 340),
        (40, 0.07, 1.52, 26.48, 349),
        (50, 0.1, 1.34, 26.46, 357),
        (60, 0.18, 1.13, 26.43, 368),
        (70, 0.3, 0.79, 26.40, 385),
    ),
    "Residence (GauU)": (
        (0, None, 3.66, 25.57, 153),
        (10, 0.02, 3.25, 25.56, 164),
        (20, 0.03, 2.78, 25.54, 175),
        (30, 0.05, 2.46, 25.51, 184),
        (40, 0.09, 2.20, 25.46, 196),
        (50, 0.14, 1.94, 25.38, 205),
        (60, 0.29, 1.54, 25.25, 220),
        (70, 0.43, 1.33, 25.10, 233),
    ),
}

FIG7 = Table(
    "fig7_paper",
    "Table of Figure 7 of the paper: λ_G grows until a share of the pairs with KPC < 0.01 is gone",
    [
        {"scene": scene, "N_low less %": low, "λ_G": factor, "N_P (M)": pairs, "PSNR": psnr, "FPS": fps}
        for scene, rows in _FIG7.items()
        for low, factor, pairs, psnr, fps in rows
    ],
    SOURCE.format("Figure 7"),
    notes=("Figure 6 is printed as a picture only; these are the paper's numbers for the same sweep.",),
)


def fig6_curves(column: str) -> list[Curve]:
    """PSNR (`PSNR`) or frames a second (`FPS`) over λ_G of the paper's sweep, a curve a scene."""
    curves = []
    for scene in _FIG7:
        rows: list[Row] = [row for row in FIG7.rows if row["scene"] == scene and row["λ_G"] is not None]
        x, y = ([float(str(row[key])) for row in rows] for key in ("λ_G", column))
        curves.append(Curve(f"{scene}, theirs", x, y, theirs=True))
    return curves
