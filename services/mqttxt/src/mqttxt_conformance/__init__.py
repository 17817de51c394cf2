"""The conformance kit: checks an implementation of a role, over the wire, against numbered rules (docs/conformance.md).

The kit encodes its messages with mqttxt's own codec and clock arithmetic. It judges received messages by `shapes`,
which implements the specification's tables and shares no code with the codec.
"""
