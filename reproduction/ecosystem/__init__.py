"""Third-party libraries, tried with our environments."""
