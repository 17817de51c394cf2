"""Shows numbers: report, comparison, summary, terminal, and the captures' frames."""
