"""Identities of nodes: names, rights, certificates, the fleet's authority (docs/protocol.md, 11)."""
