"""The wire: how messages become bytes and topics carry them."""
