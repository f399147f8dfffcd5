"""What a person reads: tables, figures, videos, error messages, and where a figure comes from."""
