"""Contracts of what users write, each as a check that runs it on a small simulated world and says in a sentence what is wrong."""
