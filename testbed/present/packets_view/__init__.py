"""`testbed packets`: shows the packets table frame by frame, dissected, or by kind of message."""
