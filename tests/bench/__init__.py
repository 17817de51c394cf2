"""Measures the figures that the documents quote: `python -m tests.bench`. Nothing here passes or fails."""
