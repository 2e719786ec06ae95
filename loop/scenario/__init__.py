"""Scenario files: their model, overrides, templates, and data that they need."""
