"""`testbed packets`: the packets table for people, frame by frame, dissected, or by kind."""
