"""All experiments, arms and profiles beside each other: a page, and tables for documents."""
