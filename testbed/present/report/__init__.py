"""The report: a table for the terminal and one self-contained page, both from `metrics.json` and the results."""
