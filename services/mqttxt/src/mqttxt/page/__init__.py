"""The live page: a ground station in a browser on this machine (docs/page.md)."""
