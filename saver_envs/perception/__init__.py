"""Seeing people: camera, skeleton, fields, network, parsing, data and training."""
