"""From a scenario to objects."""
