"""All experiments, arms and profiles in one overview: a page, and tables for documents."""
