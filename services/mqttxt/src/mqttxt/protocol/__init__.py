"""The protocol: topics, and what travels on them as bytes. No clock, no network, no node."""
