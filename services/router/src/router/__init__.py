"""The MAVLink routers of one node: mavp2p, once for each line of its chain."""
