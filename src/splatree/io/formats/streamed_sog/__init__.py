"""Streamed SOG: `lod-meta.json` over units of SOG."""
