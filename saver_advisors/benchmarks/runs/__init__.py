"""What every page told from training runs shares: their files, tables and pictures."""
