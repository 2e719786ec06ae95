"""Scenario files: model, overrides, templates, and third-party data."""
