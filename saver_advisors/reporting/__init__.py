"""Reports: tables, figures, videos, error messages, and the provenance of results."""
