"""Contracts of users' own classes: each check runs a class in a small simulated world and names the mistake in a sentence."""
