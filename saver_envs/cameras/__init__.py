"""One renderer: pictures, depth, RGB-D cameras, and a context that works without a display."""
