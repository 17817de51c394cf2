"""The protocol: topics, and their payloads as messages and as bytes. No clock, no network, no node."""
