"""Campaigns of many runs, and tuning of parameters."""
