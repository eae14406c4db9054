"""The paper's own figures: transcribed without a slip, as far as they can be checked against each other."""

import pytest

from splatree.bench.paper import FIG5, FIG7, TABLE1, TABLE2, TABLE3, fig6_curves


@pytest.mark.parametrize("row", TABLE2.rows, ids=lambda row: f"{row['filter']}-{row['shrinking']}")
def test_stages_of_table_2_add_up_to_the_total_and_give_the_frames(row):
    stages = [value for name, value in row.items() if name.startswith("T_") and name != "T_total"]
    assert sum(stages) == pytest.approx(row["T_total"], abs=0.005)
    assert 1000 / row["T_total"] == pytest.approx(row["FPS"], abs=0.6)  # printed as whole frames


def test_a_filter_changes_neither_quality_nor_pairs_in_table_3():
    by_filter = {
        name: [{k: v for k, v in row.items() if k != "filter"} for row in TABLE3.rows if row["filter"] == name]
        for name in ("serial", "parallel")
    }
    assert by_filter["serial"] == by_filter["parallel"]
    assert len(by_filter["serial"]) == 4


def test_table_3_and_figure_5_agree_where_they_show_the_same():
    shrunk = {(row["scene"][:6], row["PSNR"], row["N_P (M)"]) for row in TABLE3.rows}
    filtergs = [row for row in FIG5.rows if row["method"] == "FilterGS" and row["shrinking"] != "τ = 1/255"]
    assert {(row["scene"][:6], row["PSNR"], row["N_P (M)"]) for row in filtergs} == shrunk


def test_pairs_and_quality_fall_and_frames_grow_along_figure_7():
    for scene in ("Block Small", "Residence (GauU)"):
        rows = [row for row in FIG7.rows if row["scene"] == scene]
        assert [row["N_low less %"] for row in rows] == list(range(0, 80, 10))
        for column, sign in (("N_P (M)", -1), ("PSNR", -1), ("FPS", 1)):
            values = [sign * row[column] for row in rows]
            assert values == sorted(values)
    assert [len(curve.x) for curve in fig6_curves("FPS")] == [7, 7]


def test_table_1_has_every_method_on_every_scene():
    assert len(TABLE1.rows) == 36
    assert all(row["t_f ms"] is None for row in TABLE1.rows if row["method"] == "3DGS")
    fastest = max((row for row in TABLE1.rows if row["scene"] == "College"), key=lambda row: row["FPS"])
    assert (fastest["method"], fastest["FPS"], fastest["t_f ms"]) == ("FilterGS", 290.0, 1.05)
