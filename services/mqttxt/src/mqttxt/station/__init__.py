"""The ground station: its public API (`ground_station`), and its role as a state machine without I/O."""
