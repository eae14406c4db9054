"""The paper's tables and figures on the accelerator, against arithmetic on what the paper prints."""

import dataclasses

import pytest

import splatree as st
from splatree.bench import accelerator, jo2024
from splatree.bench.experiment import Lanes
from splatree.hardware.config import Machine, Records, Step1
from splatree.hardware.paper import COUNTS, RATES, compulsory_ms, compulsory_speed_up, fitted_common_ms

FP16 = dataclasses.replace(Machine(), records=Records("fp16"))


@pytest.fixture(scope="module")
def tables():
    report = accelerator.run(accelerator.Options(share=0.1))
    assert {figure.name for figure in report.figures} == {"accelerator_fig8", "accelerator_fig9"}
    lanes = next(figure for figure in report.figures if isinstance(figure, Lanes)).lanes
    assert list(lanes)[:3] == ["identification", "step1", "step2"]
    assert all(length > 0 for spans in lanes.values() for _, length in spans)
    return {table.name: table.rows for table in report.tables}


def test_least_times_are_those_of_the_bytes() -> None:
    scene, rates = "Kitchen", RATES["Kitchen"]
    survivors = COUNTS[scene] * (1 - rates.ideal) * 98
    without = (COUNTS[scene] * 20 + survivors) / 25.6e6
    having = (COUNTS[scene] * (1 - rates.exclusion) * 20 + survivors + 8192 * 24) / 25.6e6
    assert compulsory_ms(FP16, scene, clustering=False) == pytest.approx(without)
    assert compulsory_ms(FP16, scene, clustering=True) == pytest.approx(having)
    slow = dataclasses.replace(FP16, step1=Step1(lanes=0.1))
    assert compulsory_ms(slow, scene, clustering=False) == pytest.approx(COUNTS[scene] / 0.1 / 5e5)


@pytest.mark.parametrize("records", ["fp16", "fp32"])
def test_the_fitted_time_gives_the_papers_speed_up(records) -> None:
    machine = Machine(records=Records(records))
    assert compulsory_speed_up(machine) == pytest.approx(1.385, abs=0.01)  # nothing fitted: 1.38 to 1.39
    fitted = fitted_common_ms(machine, 1.31)
    assert compulsory_speed_up(machine, fitted) == pytest.approx(1.31)
    assert fitted == pytest.approx(1.14 if records == "fp16" else 2.31, abs=0.01)


def test_the_papers_factor_over_a_gpu_needs_a_frame_of_47_to_94_ms(tables) -> None:
    fp16, fp32 = tables["accelerator_gpu"]
    assert fp16["GPU ms for 10.7"] == pytest.approx(47, abs=0.5)
    assert fp32["GPU ms for 10.7"] == pytest.approx(94, abs=0.5)
    assert fp16["speed-up over it at most"] < 2
    verdicts = {row["claim"]: row["verdict"] for row in tables["accelerator_verdicts"]}
    assert "47 to 94 ms" in verdicts["accelerator over GPU, mean"]
    assert verdicts["accelerator over GPU, mean"].startswith("not reproducible")
    assert verdicts["clustering on the GPU, mean"].startswith("not run")
    assert verdicts["clustering on the accelerator, mean: simulated, nothing fitted"].startswith("consistent")


def test_every_figure_of_table_ii_has_a_verdict(tables) -> None:
    rows = {row["what"]: row for row in tables["accelerator_table2"]}
    words = ("reproduced", "consistent", "not reproducible (", "not run (")
    for what, (unit, theirs, _) in jo2024.TABLE_II.items():
        assert (rows[what]["unit"], rows[what]["paper"]) == (unit, theirs)
        assert rows[what]["verdict"].startswith(words)
    parts = [row["ours"] for what, row in rows.items() if what.startswith("of the area")]
    assert sum(parts) == pytest.approx(rows["area"]["ours"])
    assert rows["area"]["ours"] == pytest.approx(9.94, rel=0.05)
    assert rows["power"]["ours"] < 3.5  # what is left has no source


def test_the_time_line_overlaps_as_the_figure_shows(tables) -> None:
    rows = {row["what"]: row for row in tables["accelerator_fig8"]}
    assert rows["step 1 starts while clusters are identified"]["verdict"] == "reproduced"
    assert rows["step 2 starts while step 1 works"]["verdict"] == "reproduced"
    assert rows["identification"]["first work us"] < rows["step1"]["first work us"] < rows["step2"]["first work us"]


def test_scenes_that_exclude_more_gain_more(tables) -> None:
    rows = sorted(tables["accelerator_fig9"], key=lambda row: row["excluded %"])
    assert [row["scene"] for row in (rows[0], rows[-1])] == ["Kitchen", "Stump"]
    for column, least, most in (("speed-up by bytes", 1.08, 1.67), ("speed-up simulated", 1.07, 1.5)):
        assert rows[0][column] == pytest.approx(least, abs=0.03)
        assert rows[-1][column] == pytest.approx(most, abs=0.03)


def test_what_cannot_be_simulated_is_refused() -> None:
    with pytest.raises(st.InputError, match="share: found 0"):
        accelerator.Options(share=0)
    with pytest.raises(st.InputError, match="wanted one of Bicycle"):
        accelerator.Options(shown="Train")
    with pytest.raises(st.InputError, match=r"step1\.lanes: found 0\.0"):
        accelerator.run(accelerator.Options(set=("step1.lanes=0",)))
