"""Measures what the documents quote: `python -m tests.bench`. Figures only; nothing here passes or fails."""
