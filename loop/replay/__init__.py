"""Runs that go on with other values of keys, and recordings that are run again with theirs."""
