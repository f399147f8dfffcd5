"""Training runs: settings, start, checkpoint, resume, release."""
