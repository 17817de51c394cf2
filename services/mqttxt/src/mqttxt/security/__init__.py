"""Who a node is and what it may do: names, rights, certificates, the fleet's authority (docs/protocol.md, 11)."""
