"""The accelerator's cycle-stepped core, which `splatree.hardware` drives."""
