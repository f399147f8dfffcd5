"""Scripted experts: they solve the tasks from the observation alone, and prove that they can be."""
