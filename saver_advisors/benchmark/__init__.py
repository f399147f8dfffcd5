"""The measurements of `saver benchmark`: speed, pose, and algorithms by the protocol."""
