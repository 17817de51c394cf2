"""Real brokers, processes, links and browsers that tests use."""
