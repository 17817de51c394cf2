"""The network: one container that routes between all nodes and captures on the interface towards each."""
