import csv
import json

import numpy as np
import pytest

from splatree.bench.experiment import Curve, Grid, Panel, Plot, Report, Table
from splatree.bench.files import write_report
from splatree.errors import OutputError
from splatree.io.images import image_size

TABLES = (
    Table("ours", "Ours", [{"method": "a", "PSNR": np.float64(30.5)}, {"method": "b", "PSNR": float("inf"), "n": 3}]),
    Table("theirs", "Theirs", [{"PSNR": 1.0}], "Paper, Table 1", notes=("not measured",)),
)


def report(figures=()):
    return Report("table9", "Title", {"scene": "city", "version": "1"}, TABLES, figures)


def test_a_report_is_json_and_a_csv_for_each_table(tmp_path):
    written = write_report(report(), tmp_path / "new")
    assert sorted(path.name for path in written) == ["ours.csv", "table9.json", "theirs.csv"]
    content = json.loads((tmp_path / "new" / "table9.json").read_text())
    assert content["about"]["scene"] == "city"
    assert [table["source"] for table in content["tables"]] == ["measured in this run", "Paper, Table 1"]
    assert content["tables"][0]["rows"] == [{"method": "a", "PSNR": 30.5}, {"method": "b", "PSNR": None, "n": 3}]
    with (tmp_path / "new" / "ours.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert rows == [{"method": "a", "PSNR": "30.5", "n": ""}, {"method": "b", "PSNR": "", "n": "3"}]


def test_figures_are_drawn_with_their_captions(tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib (extra bench) is not installed")
    black = Panel("black", np.zeros((9, 16, 3)))
    figures = (
        Plot("curve", "A curve", "λ", "dB", [Curve("ours", [1, 2], [3, 4]), Curve("paper", [1], [2], theirs=True)]),
        Grid("grid", "Pictures", [[black, black], [black, black]]),
    )
    written = write_report(report(figures), tmp_path)
    for path in (path for path in written if path.suffix == ".png"):
        assert min(image_size(path)) > 300


def test_nothing_is_replaced_without_force(tmp_path):
    write_report(report(), tmp_path)
    with pytest.raises(OutputError, match="exists already"):
        write_report(report(), tmp_path)
    assert len(write_report(report(), tmp_path, force=True)) == 3
