"""Watch episodes in a browser or a window, and demonstrate tasks by hand."""
