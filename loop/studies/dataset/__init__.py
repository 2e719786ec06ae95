"""Data sets of many scenes with labels, drawn from seeds."""
