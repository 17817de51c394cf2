"""The conformance kit: checks an implementation of a role, over the wire, against numbered rules (docs/conformance.md).

What the kit sends is made by mqttxt's own codec and clock arithmetic. What it receives is judged by `shapes`, a
reading of the specification's tables that shares no code with the codec.
"""
