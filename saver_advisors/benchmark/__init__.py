"""Measurements that users repeat: speed, pose, and their own algorithms by the protocol."""
