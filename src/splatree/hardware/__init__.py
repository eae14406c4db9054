"""The cluster accelerator of Jo 2024 (§4), simulated cycle by cycle from frames that were really drawn."""
