"""The testbed: what runs on the host. Lifecycle, experiments, captures to numbers to report."""
