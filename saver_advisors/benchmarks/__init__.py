"""What `saver benchmark` measures, a room a subject: its commands and the pages they write."""
