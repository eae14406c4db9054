"""The cluster identification engine (CIE) as hardware: an integer model, the circuit in Amaranth, and its Verilog."""
